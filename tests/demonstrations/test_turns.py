"""Angles recorded within one turn are continued if declared, and named if not; nothing else is."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations, Recordings
from torch_pmil.demonstrations.turns import jumps_by_turns, turns_of, unwrapped, wrapping

TIMES = np.arange(201) / 100


def wrapped(angles: np.ndarray, turn: float = 2 * math.pi, low: float = -0.5) -> np.ndarray:
    return (angles / turn - low) % 1 * turn + low * turn


def recordings(*columns: np.ndarray) -> Recordings:
    values = tuple(torch.from_numpy(column)[:, None] for column in columns)
    times = len(columns) * (torch.from_numpy(TIMES),)
    return Recordings(tuple(map(str, range(len(columns)))), times, values, ("q",))


def noise(seed: int, size: float) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=len(TIMES))


MOTIONS = {  # rad
    "through pi": 2.8 + 0.5 * TIMES,
    "past two turns": 3.0 + 7.5 * TIMES**2,
    "back": -3.0 - 2.0 * TIMES,
    "fast": 250 * TIMES,
    "noise near pi": math.pi + noise(0, 0.02),
}


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("turn", [2 * math.pi, 360.0])
@pytest.mark.parametrize("low", [-0.5, 0.0])
def test_wrapped_angles_are_named_and_continued_on_one_turn(
    motion: str, turn: float, low: float
) -> None:
    angles = MOTIONS[motion] * turn / (2 * math.pi)
    if low == 0 and motion in ("through pi", "noise near pi"):
        angles = angles + turn / 2
    shown = recordings(wrapped(angles, turn, low), wrapped(angles, turn, low) + 3 * turn)
    assert wrapping(shown)["q"][:2] == (turn, 0)
    assert len(list(jumps_by_turns(shown))) == 1
    continued = unwrapped(shown, turns_of(shown, ["q"]), {"q": angles[0]})
    for values in continued.values:
        torch.testing.assert_close(values[:, 0], torch.from_numpy(angles), rtol=0, atol=1e-9)
    assert not wrapping(continued)


OTHERS = {
    "slow": 0.3 * TIMES,
    "fast and continuous": 400 * TIMES,
    "in mm": 150 - 150 * np.cos(5 * TIMES),
    "a noisy pixel": 300 + 200 * TIMES + noise(1, 3.0),
    "a step of 4": 4.0 * (TIMES > 1),
    "a switch": 1.0 * (TIMES > 1),
    "wheel": np.cumsum(6.0 * TIMES / 2),
}


@pytest.mark.parametrize("other", OTHERS)
def test_what_is_no_wrapped_angle_is_neither_named_nor_changed(other: str) -> None:
    shown = recordings(OTHERS[other])
    assert not wrapping(shown)
    if np.abs(np.diff(OTHERS[other])).max() < math.pi or np.ptp(OTHERS[other]) > 8:
        (values,) = unwrapped(shown, {"q": 2 * math.pi}, {}).values
        assert torch.equal(values, shown.values[0])


def test_demonstrations_are_continued_as_recordings_are() -> None:
    angles = np.stack([MOTIONS["through pi"], MOTIONS["through pi"] + 0.1])[..., ::10]
    positions: Tensor = torch.from_numpy(wrapped(angles))[..., None]
    shown = unwrapped(Demonstrations(positions, 0.1, ("q",)), {"q": 2 * math.pi}, {})
    torch.testing.assert_close(shown.positions[..., 0], torch.from_numpy(angles))


def starting(*starts: float) -> Recordings:
    return recordings(*(start + 0.5 * TIMES for start in starts))


@pytest.mark.parametrize(
    ("starts", "line"),
    [
        (
            (0, 2, 4, 6),
            "q of demonstration 2 begins at 4 and is moved by -6.283, near the 0 of demonstration "
            "0: if a turn of q is not 6.283, convert it to rad, or do not declare it an angle",
        ),
        (
            (10, 15, -181),
            "q of demonstration 2 begins at -181 and is moved by +360, near the 10 of "
            "demonstration 0: if a turn of q is not 360, convert it to rad, or do not declare it "
            "an angle",
        ),
    ],
)
def test_recording_that_is_moved_by_a_turn_that_no_jump_shows_is_named(
    starts: tuple[float, ...], line: str
) -> None:
    with pytest.warns(UserWarning) as warned:
        turns_of(starting(*starts), ["q"])
    assert len(warned) == 1
    assert str(warned[0].message) == line


def test_starts_within_half_a_turn_are_not_doubted() -> None:
    assert turns_of(starting(0, 3, -3), ["q"]) == {"q": 2 * math.pi}
    assert turns_of(starting(0, 170, -170), ["q"]) == {"q": 360.0}


def test_declared_angles_are_not_to_be_declared() -> None:
    shown = recordings(wrapped(MOTIONS["through pi"]))
    assert [*jumps_by_turns(shown)] and not [*jumps_by_turns(shown, ["q"])]
