"""What is said of a recording: ranges, spread, velocities, and what is missing for training."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.run_script import run_command
from torch_pmil.demonstrations import (
    Recordings,
    load_demonstrations,
    load_recordings,
    shipped_demonstrations,
)
from torch_pmil.demonstrations.inspection import advice, describe, spread, velocities_of

Command = Callable[..., str]
Motion = Callable[[np.ndarray], np.ndarray]
NAMES = ["biorob", "biorob_targets", "double_pendulum", "double_pendulum_targets"]
NAMES += ["gym_pendulum", "inverted_pendulum"]


def recordings(
    *samples: tuple[np.ndarray, np.ndarray],
    names: tuple[str, ...] = ("x",),
    targets: list[float] | None = None,
) -> Recordings:
    times, values = (
        tuple(torch.as_tensor(np.asarray(part), dtype=torch.float64) for part in column)
        for column in zip(*samples, strict=True)
    )
    labels = tuple(str(number) for number in range(len(samples)))
    shown, places = None, ()
    if targets is not None:
        shown, places = torch.tensor(targets, dtype=torch.float64)[:, None], ("place",)
    return Recordings(labels, times, values, names, shown, places, format="CSV")


def at(duration: float, samples: int, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    times = np.linspace(0, duration, samples)
    return times, motion(times / duration)[:, None]


def test_spread_of_the_same_motion_at_other_paces_is_zero() -> None:
    shown = recordings(at(1.0, 401, np.square), at(2.5, 801, np.square), at(0.7, 601, np.square))
    assert spread(shown)[0] < 1e-5
    assert np.isnan(spread(recordings(at(1, 11, np.square)))).all()


@pytest.mark.parametrize(
    ("offsets", "targets", "expected"),
    [([-1.0, 0.5, 2.0], None, 1.5), ([0.0, 1.0, 10.0, 11.0], [0, 0, 1, 1], np.sqrt(0.5))],
)
def test_spread_is_the_standard_deviation_of_an_offset_within_a_target(
    offsets: list[float], targets: list[float] | None, expected: float
) -> None:
    motions = enumerate(offsets, start=1)
    moved = [at(duration, 101, lambda s, by=by: by + s) for duration, by in motions]
    np.testing.assert_allclose(spread(recordings(*moved, targets=targets)), [expected], rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_velocities_are_recognised_by_what_they_are(tmp_path: Path, name: str) -> None:
    shipped_demonstrations(name).save(tmp_path / "shown.npz")
    shown = load_recordings(tmp_path / "shown.npz")
    named = {f"d{name}": name for name in shown.names if f"d{name}" in shown.names}
    found = velocities_of(shown).items()
    assert {shown.names[rate]: shown.names[position] for rate, position in found} == named
    assert len(named) == (3 if name.startswith("biorob") else 0)


def test_summary_has_number_lengths_rate_ranges_and_targets_and_says_if_steps_are_uneven() -> None:
    motions = [at(n, 10 * n + 1, motion) for motion in (np.square, np.sqrt) for n in (1, 2)]
    shown = recordings(*motions, targets=[0, 0, 1, 1])
    lines = [" ".join(line.split()) for line in describe(shown).splitlines()]
    numbers = ["demonstrations 4", "samples 11 to 21", "duration 1 to 2 s"]
    assert lines[:6] == ["format CSV", *numbers, "rate 10 Hz", "targets 2 of place"]
    assert lines[8].startswith("x ? 0 1")
    uneven = (np.array([0, 0.1, 0.25]), np.zeros((3, 1)))
    assert ", steps uneven" in describe(recordings(uneven, uneven))


ALONE = "one demonstration: training needs two at least, better three to five"
ALONE_OF_ONE = "one demonstration of target [1.0]: each needs two"
CONTROLLED = "the robot is controlled every 0.1 s"
FITTING = [at(1, 11, np.square), at(1, 11, np.sin)]


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (recordings(*FITTING), []),
        (recordings(FITTING[0]), [ALONE]),
        (recordings(FITTING[0], at(1.1, 12, np.sin)), ["lengths differ: 11 to 12 samples"]),
        (
            recordings(FITTING[0], at(0.9, 11, np.sin)),
            ["time steps differ: 0.09 to 0.1 s", f"sampled every 0.095 s, {CONTROLLED}"],
        ),
        (
            recordings(at(2, 11, np.sin), at(2, 11, np.sin)),
            [f"sampled every 0.2 s, {CONTROLLED}; what is between samples will be interpolated"],
        ),
        (recordings(*FITTING, FITTING[0], targets=[0, 0, 1]), [ALONE_OF_ONE]),
    ],
)
def test_what_is_missing_for_training_is_listed(shown: Recordings, expected: list[str]) -> None:
    if any("sample" in line or "step" in line for line in expected):
        align = "align them: pmil align recorded.csv demonstrations.npz --time-step 0.1"
        expected = [*expected, align]
    alone = "positions alone, no velocities: enough where the match space observes positions"
    assert advice(shown, "recorded.csv", 0.1) == [*expected, alone]


def test_angles_that_wrap_and_holes_are_named_with_the_way_out() -> None:
    def wraps(s: np.ndarray) -> np.ndarray:
        return (2.5 + 2 * s + np.pi) % (2 * np.pi) - np.pi

    times, values = at(1, 101, wraps)
    kept = (times < 0.505) | (times > 0.8)
    named = advice(recordings((times, values), (times[kept], values[kept])), "recorded.csv", 0.01)
    assert [line.partition(":")[0] for line in named[2:4]] == [
        "demonstration 1 has no samples from 0.5 to 0.81 s",
        "x of demonstration 0 jumps by a turn (6.283) at 0.33 s",
    ]
    assert named[4].endswith("--time-step 0.01 --angles x")
    kept = [times[::10], values[::10]]
    assert advice(recordings(kept, kept), "recorded.csv", 0.1)[1].endswith("--angles x")


def test_nothing_is_missing_from_what_training_takes(tmp_path: Path) -> None:
    shipped_demonstrations("biorob").save(tmp_path / "shown.npz")
    assert advice(load_recordings(tmp_path / "shown.npz"), "shown.npz", 0.1) == []


@pytest.fixture
def inspect(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """The command line; returns what it prints."""

    def run(*arguments: object) -> str:
        run_command(monkeypatch, "inspect", *arguments)
        return capsys.readouterr().out

    return run


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Three reaches at 100 Hz, of their own length; columns q and dq and one of words."""
    rows = ["demonstration,time,q,dq,phase"]
    for label, samples in enumerate((101, 121, 91)):
        s = np.linspace(0, 1, samples)
        q, dq = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * (s * (1 - s)) ** 2 / (0.01 * (samples - 1))
        motion = enumerate(zip(q, dq, strict=True))
        rows += [f"{label},{0.01 * number},{at},{rate},reach" for number, (at, rate) in motion]
    (tmp_path / "recorded reaches.csv").write_text("\n".join(rows))
    return tmp_path / "recorded reaches.csv"


def test_command_that_is_advised_makes_what_training_takes(
    inspect: Command, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = inspect(recorded, "--keys", "q", "dq", "--names", "angle", "rate")
    advised = next(line for line in printed.splitlines() if line.startswith("- align them: "))
    pmil, align, *arguments = shlex.split(advised.removeprefix("- align them: "))
    assert (pmil, align) == ("pmil", "align") and arguments[-2:] == ["--velocities", "rate"]
    monkeypatch.chdir(recorded.parent)
    run_command(monkeypatch, align, *arguments)
    assert load_demonstrations("demonstrations.npz", 0.1).names == ("angle", "rate")
    end = ["before training", "- nothing to do: it is loaded as it is"]
    assert inspect("demonstrations.npz").splitlines()[-2:] == end
    again = " demonstrations.npz aligned.npz --time-step 0.05"
    assert again in inspect("demonstrations.npz", "--control-period", "0.05")


def test_recordings_without_times_are_inspected_and_aligned_at_the_step_that_is_given(
    inspect: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "reach.hdf5", "w") as file:
        for number, length in enumerate((30, 40)):
            file[f"data/demo_{number}/obs/q"] = np.linspace(0, 1, length) ** 2
    monkeypatch.chdir(tmp_path)
    for line in ("inspect reach.hdf5", "align reach.hdf5 aligned.npz"):
        with pytest.raises(SystemExit, match=r"\(--recorded-time-step .*\) must be given, in s"):
            run_command(monkeypatch, *line.split())
    printed = inspect("reach.hdf5", "--recorded-time-step", "0.05", "--control-period", "0.25")
    advised = next(line for line in printed.splitlines() if line.startswith("- align them: "))
    options = "--time-step 0.25 --recorded-time-step 0.05"
    assert advised.endswith(f"reach.hdf5 demonstrations.npz {options}")
    run_command(monkeypatch, "align", *shlex.split(advised)[5:])
    assert load_demonstrations("demonstrations.npz", 0.25).duration == 1.5


def test_times_that_are_not_seconds_are_named_before_training(
    inspect: Command, tmp_path: Path
) -> None:
    rows = [f"{number},{10 * step},{step}" for number in (1, 2) for step in range(100)]
    (tmp_path / "reach.csv").write_text("\n".join(["demonstration,time,q", *rows]))
    printed = inspect(tmp_path / "reach.csv")
    assert "\n- time looks like milliseconds, not seconds: steps of 10 where the robot" in printed
    assert "align them" not in printed
    (tmp_path / "reach.csv").write_text("\n".join(["demonstration,time_s,q", *rows]))
    assert "time looks like" not in inspect(tmp_path / "reach.csv")


def test_picture_is_drawn_if_asked_and_a_column_of_words_is_one_line(
    inspect: Command, recorded: Path
) -> None:
    picture = recorded.with_name("drawn.png")
    assert f"wrote {picture}" in inspect(recorded, "--keys", "q", "--draw", picture)
    assert picture.read_bytes()[:4] == b"\x89PNG"
    words = "row 2, column phase must be a finite number, or left out by keys, got 'reach'"
    with pytest.raises(SystemExit, match=rf"error: .*recorded reaches.csv: {words}"):
        inspect(recorded)
