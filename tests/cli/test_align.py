"""``pmil align``: from a recording with uneven samples to demonstrations that load."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from tests.helpers.run_script import run_command
from torch_pmil.demonstrations import DemonstrationError, load_demonstrations

Script = Callable[..., None]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Script:
    return partial(run_command, monkeypatch, "align")


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Three reaches of 1 rad at 100 Hz with jitter, after rests, at different paces (q and dq)."""
    draws, rows = np.random.default_rng(0), ["demonstration,time,q,dq"]
    for label, (rest, duration) in enumerate([(0.1, 1.0), (0.3, 1.3), (0.2, 0.8)]):
        times = np.arange(0, rest + duration + 0.2, 0.01)
        times[1:-1] += draws.uniform(-0.002, 0.002, len(times) - 2)
        s = np.clip((times - rest) / duration, 0, 1)
        q, dq = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * (s * (1 - s)) ** 2 / duration
        rows += [f"{label},{row[0]},{row[1]},{row[2]}" for row in zip(times, q, dq, strict=True)]
    path = tmp_path / "recorded.csv"
    path.write_text("\n".join(rows))
    return path


def test_what_loading_refuses_is_aligned_as_its_message_says(
    script: Script, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(DemonstrationError, match=r"pmil align makes them one length"):
        load_demonstrations(recorded)
    out = recorded.with_suffix(".npz")
    script(recorded, out, "--velocities", "dq", "--crop")
    demonstrations = load_demonstrations(out, time_step=0.1)
    samples = demonstrations.positions.shape[1]
    said = f"wrote {out}: 3 demonstrations of {samples} samples, 0.9 s\n"
    assert capsys.readouterr().out == said
    q, dq = demonstrations.positions.unbind(-1)
    assert q.std(0).max() < 0.02
    assert (torch.gradient(q, spacing=0.1, dim=-1)[0] - dq)[:, 1:-1].abs().max() < 0.15 * dq.max()


def test_targets_are_carried_through_and_never_warped(script: Script, recorded: Path) -> None:
    header, *rows = recorded.read_text().splitlines()
    places = (("near", 0.25), ("far", 1.75))
    targeted = [f"{label}{row},{place}" for label, place in places for row in rows]
    script(recorded, out := recorded.with_suffix(".npz"), "--velocities", "dq")
    plain = load_demonstrations(out)
    recorded.write_text("\n".join([f"{header},target place", *targeted]))
    script(recorded, out, "--velocities", "dq", "--overwrite")
    aligned = load_demonstrations(out)
    assert aligned.targets.tolist() == 3 * [[0.25]] + 3 * [[1.75]]
    assert aligned.target_names == ("place",) and aligned.names == plain.names
    assert torch.equal(aligned.positions[:3], aligned.positions[3:])
    torch.testing.assert_close(aligned.positions[:3], plain.positions, rtol=0, atol=1e-9)


def test_output_that_is_there_is_replaced_if_asked_and_rests_are_kept(
    script: Script, recorded: Path
) -> None:
    out, picture = recorded.with_suffix(".npz"), recorded.with_suffix(".png")
    for path in (out, picture):
        path.write_text("old")
    script(recorded, out, "--draw", picture, "--overwrite")
    assert load_demonstrations(out).duration > 1.3 and picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("broken", ["cli.align.draw", "demonstrations.Demonstrations.save"])
def test_demonstrations_and_their_picture_are_written_both_or_neither(
    script: Script, recorded: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    monkeypatch.setattr(f"torch_pmil.{broken}", Mock(side_effect=OSError("disk full")))
    with pytest.raises(SystemExit, match=r"^error: disk full"):
        script(recorded, recorded.with_suffix(".npz"), "--draw", recorded.with_suffix(".png"))
    assert list(recorded.parent.iterdir()) == [recorded]


@pytest.fixture
def tracked(tmp_path: Path) -> Path:
    """Three noisy strokes of a point, in pixels at 60 Hz, one of them with a jump."""
    draws, rows = np.random.default_rng(0), ["demonstration,time,x,y"]
    for label, duration in (("slow", 1.2), ("fast", 0.9), ("middle", 1.0)):
        times = np.arange(0, duration, 1 / 60)
        x, y = 0.4 * times / duration, 0.2 * np.sin(np.pi * times / duration)
        pixels = np.stack([200 + 1000 * x, 800 - 1000 * y], 1) + draws.normal(size=(len(times), 2))
        if label == "middle":
            pixels[20:22] = 900.0, 100.0
        rows += [f"{label},{t},{x},{y}" for t, (x, y) in zip(times, pixels, strict=True)]
    path = tmp_path / "tracked.csv"
    path.write_text("\n".join(rows))
    return path


MARKERS = ("200 800 0 0", "600 800 0.4 0", "600 600 0.4 0.2", "200 600 0 0.2")


def test_pixels_with_jumps_become_metres_and_velocities(script: Script, tracked: Path) -> None:
    out, picture = tracked.with_suffix(".npz"), tracked.with_suffix(".png")
    markers = [word for marker in MARKERS for word in ("--marker", *marker.split())]
    steps = "--fastest 2 --smooth 0.3 --derive dx=x dy=y --window 0.3 --reference fast"
    script(tracked, out, *markers, *steps.split(), "--draw", picture)
    demonstrations = load_demonstrations(out, time_step=0.1)
    assert demonstrations.names == ("x", "y", "dx", "dy") and demonstrations.positions.shape[1] == 9
    times = 0.1 * torch.arange(9, dtype=torch.float64)
    phase = torch.pi * times / 0.9
    places = [0.4 * times / 0.9, 0.2 * phase.sin()]
    speeds = [torch.full_like(times, 0.4 / 0.9), 0.2 * torch.pi / 0.9 * phase.cos()]
    expected = torch.stack(places + speeds, -1)
    error = (demonstrations.positions - expected)[:, 1:-1].abs().amax((0, 1))
    assert (error[:2] < 0.015).all() and (error[2:] < 0.12).all()
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.fixture
def turning(tmp_path: Path) -> Path:
    """Three turns of 4 rad from 2 rad at 100 Hz, wrapped, in rad and degrees; one with a hole."""
    rows = ["demonstration,time,q,yaw"]
    for label, steps in enumerate((180, 200, 220)):
        s = np.linspace(0, 1, steps + 1)
        q = 2 + 4 * (3 * s**2 - 2 * s**3)
        wrapped = np.arctan2(np.sin(q), np.cos(q))
        kept = [number for number in range(steps + 1) if label or not 60 < number < 120]
        rows += [f"{label},{0.01 * k:.2f},{wrapped[k]},{np.degrees(wrapped[k])}" for k in kept]
    path = tmp_path / "turning.csv"
    path.write_text("\n".join(rows))
    return path


def test_declared_angles_go_on_and_what_is_doubtful_is_named(
    script: Script, turning: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script(turning, out := turning.with_suffix(".npz"), "--angles", "q", "yaw")
    q, yaw = load_demonstrations(out).positions.unbind(-1)
    assert q[:, 0].allclose(torch.tensor(2.0).double()) and (q[:, -1] - 6).abs().max() < 0.01
    torch.testing.assert_close(yaw, q.rad2deg(), rtol=0, atol=2.0)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "demonstration 0 has no samples from 0.6 to 1.2 s" in said[0]
    script(turning, out, "--overwrite")
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3 and all("jumps by a turn" in line for line in said[1:])
    assert "(6.283)" in said[1] and "(360)" in said[2]


def test_recordings_that_only_jitter_are_aligned_only_on_request(
    script: Script, tmp_path: Path
) -> None:
    draws, rows = np.random.default_rng(0), ["demonstration,time,q"]
    for label in range(3):
        times = np.arange(201) / 100 + draws.uniform(-1e-3, 1e-3, 201)
        rows += [f"{label},{1.7e9 + t:.7f},{(1 + 0.2 * label) * np.sin(2 * t)}" for t in times]
    path = tmp_path / "hardware.csv"
    path.write_text("\n".join(rows))
    script(path, plain := tmp_path / "plain.npz")
    script(path, warped := tmp_path / "warped.npz", "--window", "0.2")
    motion = torch.sin(0.2 * torch.arange(21, dtype=torch.float64))
    expected = torch.tensor([1.0, 1.2, 1.4])[:, None] * motion
    assert (load_demonstrations(plain).positions[..., 0] - expected).abs().max() < 0.005
    assert (load_demonstrations(warped).positions[..., 0] - expected).abs().max() > 0.01
