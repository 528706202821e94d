"""Videos: as many frames as were given, of their size, in a file that is whole or absent."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image

from tests.helpers.killing import end_of, fork
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.files import remove_temporaries
from torch_pmil.plotting import video
from torch_pmil.plotting.video import render_rollout, write_gif, write_video


def shades(count: int, height: int = 32, width: int = 48) -> list[np.ndarray]:
    """Pictures from black to white."""
    levels = np.linspace(0, 255, count)
    return [np.full((height, width, 3), level, dtype=np.uint8) for level in levels]


def decode(path: Path, height: int, width: int) -> tuple[str, np.ndarray]:
    """What ffmpeg says about a video, and its frames (count, height, width, 3)."""
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, *raw]
    decoded = subprocess.run(command, capture_output=True, check=True)
    frames = np.frombuffer(decoded.stdout, np.uint8).reshape(-1, height, width, 3)
    return decoded.stderr.decode(), frames


class StatesAsPictures(DoublePendulumEnv):
    """Its pictures are the states themselves, so that no OpenGL is needed."""

    def draw(self, physics: torch.Tensor) -> np.ndarray:
        return self.state_of(physics).numpy()


@pytest.mark.parametrize(("height", "width"), [(32, 48), (33, 47), (50, 50)])
def test_video_decodes_to_the_frames_written(tmp_path: Path, height: int, width: int) -> None:
    path, frames = tmp_path / "shades.mp4", shades(7, height, width)
    path.write_text("old")
    write_video(path, iter(frames), fps=50)
    assert list(tmp_path.iterdir()) == [path]
    even = height + height % 2, width + width % 2
    about, decoded = decode(path, *even)
    assert re.search(rf"Video: h264 .* yuv420p\b.*, {even[1]}x{even[0]}\b.*, 50 fps", about)
    assert len(decoded) == 7
    means = decoded[:, :height, :width].mean((1, 2, 3))
    np.testing.assert_allclose(means, [frame.mean() for frame in frames], atol=6)


def test_encoding_is_silent(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    write_video(tmp_path / "odd.mp4", shades(3, 33, 47), fps=50)
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


@pytest.mark.parametrize("whole", [0, 2])
def test_frames_that_fail_leave_the_old_video(tmp_path: Path, whole: int) -> None:
    def failing() -> Iterator[np.ndarray]:
        yield from shades(whole)
        raise RuntimeError("pictures need OpenGL")

    path = tmp_path / "shades.mp4"
    path.write_text("old")
    with pytest.raises(RuntimeError, match="pictures need OpenGL"):
        write_video(path, failing(), fps=50)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (
            [np.zeros((32, 48), np.uint8)],
            r"frames must have shape \(height, width, 3\), got \(32, 48\)",
        ),
        (
            [*shades(2), *shades(1, 16, 16)],
            r"frame 2 must be uint8 of shape \(32, 48, 3\), got uint8 of shape \(16, 16, 3\)",
        ),
    ],
)
def test_bad_frames_are_refused(tmp_path: Path, frames: list[np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        write_video(tmp_path / "bad.mp4", frames, fps=50)
    assert not list(tmp_path.iterdir())


def test_rollout_is_pictured_five_times_a_step_along_its_own_motion() -> None:
    env = StatesAsPictures(seed=0)
    generator = torch.Generator().manual_seed(0)
    actions = 2 * torch.randn(3, 2, dtype=torch.float64, generator=generator)
    pictures = np.stack(list(render_rollout(env, env.initial_mean, actions)))
    states = [env.initial_mean]
    for action in actions:
        states.append(env.simulate(states[-1][None], action[None])[0])
    assert pictures.shape == (16, 4)
    np.testing.assert_array_equal(pictures[::5], torch.stack(states))


def test_gif_shows_the_video_in_its_own_time_rests_for_a_second_and_begins_anew(
    tmp_path: Path,
) -> None:
    write_video(tmp_path / "shades.mp4", shades(50), fps=50)
    write_gif(tmp_path / "shades.gif", tmp_path / "shades.mp4")
    with Image.open(tmp_path / "shades.gif") as gif:
        shown, durations = [], []
        for number in range(gif.n_frames):
            gif.seek(number)
            shown.append(np.asarray(gif.convert("RGB")).mean())
            durations.append(gif.info["duration"])
        assert gif.info["loop"] == 0  # for ever
        assert gif.size == (48, 32)
    assert sum(durations) == pytest.approx(2000, abs=40)  # ms
    np.testing.assert_allclose(shown[:25], np.linspace(0, 255, 50)[::2], atol=12)
    np.testing.assert_allclose(shown[25:], 255, atol=12)


@pytest.mark.parametrize("content", [None, b"no video"])
def test_gif_of_no_video_is_an_os_error_and_leaves_the_old_one(
    tmp_path: Path, content: bytes | None
) -> None:
    video, gif = tmp_path / "shades.mp4", tmp_path / "shades.gif"
    gif.write_text("old")
    if content is not None:
        video.write_bytes(content)
    with pytest.raises(OSError, match=r"no GIF of .*shades\.mp4"):
        write_gif(gif, video)
    assert gif.read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} <= {"shades.mp4", "shades.gif"}


def ffmpeg_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """A program in ffmpeg's place."""
    program = tmp_path / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o700)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(program))


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("sleep 60", r"ffmpeg made no video: it did nothing for 0\.5 s, and was ended"),
        ("cat > /dev/null; exit 3", "ffmpeg made no video: it ended with status 3"),
        ("echo no codec >&2; exit 1", "ffmpeg made no video: no codec"),
    ],
    ids=["hangs", "fails", "fails at once"],
)
def test_ffmpeg_that_hangs_or_fails_is_an_os_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, said: str
) -> None:
    monkeypatch.setattr(video, "PATIENCE", 0.5)
    ffmpeg_does(tmp_path, monkeypatch, script)
    begun = time.monotonic()
    with pytest.raises(OSError, match=said):  # more bytes than a pipe holds
        write_video(tmp_path / "shades.mp4", shades(3, 200, 200), fps=50)
    with pytest.raises(OSError, match="ffmpeg made no GIF of"):
        write_gif(tmp_path / "shades.gif", tmp_path / "shades.mp4")
    assert time.monotonic() - begun < 30
    assert [path.name for path in tmp_path.iterdir()] == ["ffmpeg"]


def test_ffmpeg_makes_no_file_anew_after_the_death_of_the_process_that_began_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be slow to begin; a run that is resumed meanwhile removes what was left before."""
    out, step = tmp_path / "run", f"touch {tmp_path}/{{}}"
    out.mkdir()
    wait = f"while [ ! -e {tmp_path}/go ]; do sleep 0.01; done"
    write = 'for last; do :; done; echo late > "${last#file:}"'
    begin, end = step.format("begun"), step.format("ended")
    ffmpeg_does(tmp_path, monkeypatch, f"{begin}; {wait}; {write}; {end}")
    maker = fork(lambda: write_video(out / "shades.mp4", shades(2), fps=50), tmp_path / "log")
    wait_for(tmp_path / "begun")
    os.kill(maker, signal.SIGKILL)
    assert end_of(maker) == -signal.SIGKILL
    assert [path.name for path in out.iterdir()] == [f".shades.{maker}.mp4"]
    remove_temporaries(out / "shades.mp4")
    (tmp_path / "go").touch()
    wait_for(tmp_path / "ended")
    assert list(out.iterdir()) == []


def wait_for(path: Path) -> None:
    end = time.monotonic() + 30
    while not path.exists():
        assert time.monotonic() < end, f"{path} did not come"
        time.sleep(0.01)


def test_missing_ffmpeg_is_an_os_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "nowhere"))
    with pytest.raises(OSError, match="nowhere"):
        write_video(tmp_path / "shades.mp4", shades(3), fps=50)

    def none() -> str:
        raise RuntimeError("No ffmpeg exe could be found")

    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", none)
    with pytest.raises(OSError, match="ffmpeg is missing: No ffmpeg exe"):
        write_video(tmp_path / "shades.mp4", shades(3), fps=50)


@pytest.mark.parametrize("folder", ["-i", "http:", "pipe:1", "a:b", "concat:x|y", "100%d"])
def test_folder_is_taken_for_no_option_and_no_protocol(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(folder).mkdir()
    write_video(f"{folder}/-y.mp4", shades(2), fps=50)
    write_gif(f"{folder}/-y.gif", f"{folder}/-y.mp4")
    assert {path.name for path in Path(folder).iterdir()} == {"-y.mp4", "-y.gif"}
