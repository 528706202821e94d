"""Videos: pictures of a rollout, an H.264 file of them, and a GIF of that file."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from threading import Timer
from typing import IO

import imageio_ffmpeg
import numpy as np
from torch import Tensor

from torch_pmil.checks import check_positive
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.files import replacing

PATIENCE = 60.0  # s without progress after which ffmpeg is killed
# an MP4, whatever the file is called, with its index first, so that a browser plays it at once
MP4 = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", "10", "-f", "mp4"]
MP4 += ["-movflags", "+faststart"]
# a GIF counts in hundredths of a second, and 25 pictures per second are enough; the last one stays;
# the palette is that of this video without dithering, which flickers
GIF_FILTER = (
    "fps='min(25,source_fps)',tpad=stop_mode=clone:stop_duration=1,split[a][b];"
    "[a]palettegen[p];[b][p]paletteuse=dither=none"
)
GIF = ["-filter_complex", GIF_FILTER, "-f", "gif"]
FORMATS = {".gif": GIF, ".mp4": MP4}  # of a film, by its suffix


def render_rollout(
    env: MujocoRobotEnv, start: Tensor, actions: Tensor, frames_per_step: int = 5
) -> Iterator[np.ndarray]:
    """Pictures of a rollout, ``frames_per_step`` in each control period.

    A control period of 0.1 s is too coarse for the eye; five pictures in it make 50 Hz. The motion
    is simulated anew from the start, and the state of the environment does not change.

    Args:
        env: the robot; its ``pixel_size`` is the size of the pictures.
        start: state vector (D,).
        actions: (T, F), each held for a control period.
        frames_per_step: a divisor of ``env.substeps``.

    Returns:
        T · frames_per_step + 1 pictures (height, width, 3), uint8.

    Raises:
        ValueError: the period does not split into that many steps.
        RuntimeError: OpenGL is not available, or the simulation diverged.

    Example:
        >>> import torch
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> env = DoublePendulumEnv()
        >>> actions = torch.zeros(25, 2, dtype=torch.float64)
        >>> pictures = render_rollout(env, env.initial_mean, actions)
        >>> write_video("hanging.mp4", pictures, fps=50)  # doctest: +SKIP
    """
    return map(env.draw, env.replay(start, actions, frames_per_step))


def dense_states(
    env: MujocoRobotEnv, start: Tensor, actions: Tensor, states_per_step: int = 5
) -> Tensor:
    """States of a rollout, several in each control period, (T · states_per_step + 1, D).

    Args:
        env: the robot; its state does not change.
        start: state vector (D,), the first one returned.
        actions: (T, F), each held for a control period.
        states_per_step: a divisor of ``env.substeps``.

    Raises:
        ValueError: the period does not split into that many steps.
        RuntimeError: the simulation diverged.

    Example:
        >>> import torch
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> env = DoublePendulumEnv()
        >>> dense_states(env, env.initial_mean, torch.zeros(25, 2, dtype=torch.float64)).shape
        torch.Size([126, 4])
    """
    return env.state_of(env.replay(start, actions, states_per_step))


def write_video(path: Path | str, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write pictures as an H.264 video (MP4, yuv420p), wholly or not at all.

    Args:
        path: the file to write; an existing file is replaced.
        frames: pictures (height, width, 3), uint8, all of one size. An odd height or width, which
            the format cannot hold, grows by repeating the last row or column.
        fps: pictures per second.

    Raises:
        ValueError: there are no frames, one has another shape or type, or ``fps`` is not positive.
        OSError: the folder is missing or not writable, or ffmpeg is missing, failed, or made no
            progress for ``PATIENCE``.

    Example:
        >>> import tempfile
        >>> black = np.zeros((16, 16, 3), dtype=np.uint8)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_video(f"{folder}/black.mp4", [black] * 3, fps=50)
        ...     imageio_ffmpeg.count_frames_and_secs(f"{folder}/black.mp4")[0]
        3
    """
    _write(path, frames, fps, MP4)


def write_film(path: Path | str, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write pictures as a video or as a GIF, depending on the suffix.

    A GIF has at most 25 pictures per second, repeats for ever, and rests on the last picture for a
    second. Arguments and errors are those of :func:`write_video`.

    Args:
        path: the file to write, ending in .gif or .mp4; an existing file is replaced.
        frames: pictures (height, width, 3), uint8, all of one size.
        fps: pictures per second.

    Raises:
        ValueError: the name has another suffix.

    Example:
        >>> import tempfile
        >>> black = np.zeros((16, 16, 3), dtype=np.uint8)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_film(f"{folder}/black.gif", [black] * 25, fps=50)
        ...     Path(f"{folder}/black.gif").read_bytes()[:6]
        b'GIF89a'
    """
    check_film_name(path)
    _write(path, frames, fps, FORMATS[Path(path).suffix])


def check_film_name(path: Path | str) -> None:
    """Raise ValueError unless a name ends in .gif or .mp4."""
    if Path(path).suffix not in FORMATS:
        raise ValueError(f"a film must be a {' or '.join(FORMATS)} file, got {path}")


def write_gif(path: Path | str, video: Path | str) -> None:
    """Write a video as a GIF that repeats for ever, wholly or not at all.

    It has the size and speed of the video, at most 25 pictures per second, and rests on the last
    picture for a second.

    Args:
        path: the file to write; an existing file is replaced.
        video: a file that :func:`write_video` wrote.

    Raises:
        OSError: the video is missing or not a video, or the folder is missing or not writable.

    Example:
        >>> import tempfile
        >>> black = np.zeros((16, 16, 3), dtype=np.uint8)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_video(f"{folder}/black.mp4", [black] * 25, fps=50)
        ...     write_gif(f"{folder}/black.gif", f"{folder}/black.mp4")
        ...     Path(f"{folder}/black.gif").read_bytes()[:6]
        b'GIF89a'
    """
    with replacing(path) as temporary:
        _run_ffmpeg(["-i", url(Path(video)), *GIF], temporary, (), f"no GIF of {video}")


def url(path: Path) -> str:
    """The name of a file for ffmpeg, which cannot take it for an option or a protocol.

    Example:
        >>> url(Path("/runs/http:/-i.mp4"))
        'file:/runs/http:/-i.mp4'
    """
    return f"file:{path.absolute()}"


def _write(path: Path | str, frames: Iterable[np.ndarray], fps: float, form: list[str]) -> None:
    fps = check_positive("fps", fps)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise ValueError("a video needs at least one frame, got none")
    shape = first.shape
    if len(shape) != 3 or shape[2] != 3 or not all(shape):
        raise ValueError(f"frames must have shape (height, width, 3), got {shape}")
    margin = [(0, shape[0] % 2), (0, shape[1] % 2), (0, 0)]
    size = f"{shape[1] + shape[1] % 2}x{shape[0] + shape[0] % 2}"
    rate = str(Fraction(fps).limit_denominator())
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", rate, "-i", "pipe:0"]
    chunks = _checked(itertools.chain([first], frames), shape, margin)
    with replacing(path) as temporary:
        _run_ffmpeg([*raw, *form], temporary, chunks, "no video")


def _checked(
    frames: Iterable[np.ndarray], shape: tuple[int, ...], margin: list[tuple[int, int]]
) -> Iterator[bytes]:
    """The bytes of each frame with its margin; raises ValueError at one of another kind."""
    for count, frame in enumerate(frames):
        if frame.shape != shape or frame.dtype != np.uint8:
            raise ValueError(
                f"frame {count} must be uint8 of shape {shape}, got {frame.dtype} of shape "
                f"{frame.shape}"
            )
        yield np.pad(frame, margin, mode="edge").tobytes()


def _run_ffmpeg(arguments: list[str], path: Path, chunks: Iterable[bytes], complaint: str) -> None:
    """Run ffmpeg on these bytes to fill a file; raises OSError if it fails or stalls."""
    try:
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *arguments]
    except RuntimeError as error:
        raise OSError(f"ffmpeg is missing: {error}") from error
    with path.open("wb") as file, tempfile.TemporaryFile() as said:
        with _started(command, path, file.fileno(), said) as process:
            _feed(process, chunks)
        if process.returncode:
            said.seek(0)
            lines = said.read().decode(errors="replace").strip().splitlines()
            ended = f"it ended with status {process.returncode}"
            if process.returncode == -signal.SIGKILL:
                ended = f"it did nothing for {PATIENCE:g} s, and was ended"
            raise OSError(f"ffmpeg made {complaint}: {lines[-1] if lines else ended}")


def _started(command: list[str], path: Path, file: int, said: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start ffmpeg with an open file of that path to fill."""
    # If this process is killed, ffmpeg ends a little later, and must not create the file again. So
    # it writes to the open file, if the system has a path for it, as Linux does
    opened = Path(f"/proc/self/fd/{file}")
    there = opened.exists()
    return subprocess.Popen(
        [*command, url(opened if there else path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=said,
        start_new_session=True,
        pass_fds=[file] if there else (),
    )


def _feed(process: subprocess.Popen[bytes], chunks: Iterable[bytes]) -> None:
    """Write all chunks and wait for the end of the process, which is killed at a long pause."""
    assert process.stdin is not None
    try:
        with suppress(BrokenPipeError):  # it ended early; its status says why
            for chunk in chunks:
                with _patience(process):
                    process.stdin.write(chunk)
            with _patience(process):
                process.stdin.close()
        with _patience(process):
            process.wait()
    finally:
        _kill(process)
        with suppress(BrokenPipeError):
            process.stdin.close()


@contextmanager
def _patience(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """Kill the process if the block takes too long."""
    timer = Timer(PATIENCE, _kill, (process,))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and its children, which would hold its pipes."""
    with suppress(ProcessLookupError):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
