"""Drawn strokes are checked and become demonstrations, however they were sampled."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations, load_demonstrations, load_recordings
from torch_pmil.demonstrations.preparation.drawing import (
    SIDE,
    DrawingError,
    drawn_demonstrations,
    read_strokes,
    save_drawing,
)

Samples = list[list[float]]
PIXEL = SIDE / 500  # m
CLOSE = 0.0025  # m, in 3 ms at the largest speed of these strokes
# moments when a quarter, a half and three quarters of the way are done
PACES = ([0.25, 0.5, 0.75], [0.2, 0.5, 0.8], [0.3, 0.55, 0.75], [0.25, 0.45, 0.7], [0.3, 0.5, 0.8])


def wave(s: np.ndarray) -> np.ndarray:
    """An S on its side, fractions (right, down) of the square, (T, 2)."""
    return np.stack([0.2 + 0.6 * s, 0.5 + 0.25 * np.sin(2 * np.pi * s)], -1)


def stroke(
    pace: list[float],
    duration: float = 1.2,
    rate: float = 125,
    rests: tuple[float, float] = (0, 0),
    turn: float = 0,
    jitter: int | None = None,
) -> Samples:
    """The wave at a pace, from rest to rest, turned about the middle of the square, in rad."""
    draws = np.random.default_rng(jitter)
    times = np.arange(0, sum(rests) + duration, 1 / rate)
    if jitter is not None:
        times[1:] += draws.uniform(0, 0.9 / rate, len(times) - 1)
    moment = np.clip((times - rests[0]) / duration, 0, 1)
    done = PchipInterpolator([0, *pace, 1], [0, 0.25, 0.5, 0.75, 1])(moment**2 * (3 - 2 * moment))
    turned = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return np.column_stack([1000 * times + 4321.5, (wave(done) - 0.5) @ turned.T + 0.5]).tolist()


def strokes(**settings: object) -> list[Samples]:
    return [
        stroke(pace, duration, **settings)
        for pace, duration in zip(PACES, (1.1, 1.3, 1.2, 1.0, 1.4), strict=True)
    ]


def demonstrations(samples: list[Samples], time_step: float = 0.1) -> Demonstrations:
    return drawn_demonstrations(read_strokes(json.dumps(samples)), time_step)


def off_the_path(positions: Tensor) -> float:
    """Largest distance of positions in m from the wave."""
    right, down = wave(np.linspace(0, 1, 5001)).T
    path = torch.from_numpy(SIDE * np.stack([right, 1 - down], -1))
    return torch.cdist(positions.reshape(-1, 2), path).amin(1).amax().item()


def test_corners_of_the_square_are_metres_with_y_up() -> None:
    across = [[10 * k, k / 40, k / 40] for k in range(41)]
    recorded = read_strokes(json.dumps([across, across]))
    assert recorded.names == ("x", "y") and recorded.labels == ("1", "2")
    ends = torch.tensor([[0, SIDE], [SIDE, 0]], dtype=torch.float64)
    torch.testing.assert_close(recorded.values[0][[0, -1]], ends)
    assert recorded.times[0][[0, -1]].tolist() == [0, 0.4]


def test_demonstrations_begin_and_end_where_strokes_do_and_stay_on_them() -> None:
    drawn = demonstrations(strokes())
    ends = SIDE * torch.tensor([[0.2, 0.5], [0.8, 0.5]], dtype=torch.float64)
    assert (drawn.positions[:, [0, -1]] - ends).abs().max() < CLOSE
    assert off_the_path(drawn.positions) < PIXEL


def test_timing_of_their_own_is_taken_away() -> None:
    recorded = read_strokes(json.dumps(strokes()))
    evenly = [
        values[np.linspace(0, len(values) - 1, 13).round().astype(int)]
        for values in recorded.values
    ]
    spread, spread_left = (
        positions.std(0).square().mean().sqrt()
        for positions in (torch.stack(evenly), drawn_demonstrations(recorded).positions)
    )
    assert spread_left < 0.25 * spread


def test_mean_duration_is_kept_to_a_whole_number_of_time_steps() -> None:
    moving = demonstrations(strokes(), 0.01).duration
    assert 1.1 < moving < 1.2
    for step in (0.1, 0.2, 0.3):
        assert abs(demonstrations(strokes(), step).duration - moving) <= step / 2


def from_pixel_to_pixel() -> list[Samples]:
    return [
        [[time, round(500 * right) / 500, round(500 * down) / 500] for time, right, down in each]
        for each in strokes(rate=1000)
    ]


def trembling_at_rest() -> list[Samples]:
    """By a pixel."""
    draws, trembling = np.random.default_rng(0), strokes(rests=(0.7, 0.4))
    shifts = [draws.choice([-0.5, 0.5], size=(len(samples), 2)) / 500 for samples in trembling]
    return [
        (np.array(samples) + np.pad(shift, [(0, 0), (1, 0)])).tolist()
        for samples, shift in zip(trembling, shifts, strict=True)
    ]


@pytest.mark.parametrize(
    "sampled",
    [
        strokes(rate=60),
        strokes(rate=1000),
        strokes(rate=125, jitter=3),
        from_pixel_to_pixel(),
        strokes(rests=(0.7, 0.4)),
        trembling_at_rest(),
    ],
    ids=["slow", "fast", "uneven", "pixels", "rests", "trembling"],
)
def test_rate_steps_between_pixels_and_rests_do_not_matter(sampled: list[Samples]) -> None:
    found, expected = (demonstrations(each).positions for each in (sampled, strokes()))
    torch.testing.assert_close(found, expected, rtol=0, atol=CLOSE)


def test_rest_on_the_way_without_samples_is_bridged_without_overshoot() -> None:
    """Two quick samples before the rest give a spline a slope to overshoot with."""
    halfway = [[8 * k, 0.1 + 0.01 * k, 0.5] for k in range(41)]
    resting = [*halfway, [halfway[-1][0] + 0.1, 0.505, 0.5]]
    rest = [[time + 800, right + 0.005, down] for time, right, down in halfway[1:]]
    onwards = [[time, right + 0.4, down] for time, right, down in rest]
    x = demonstrations([resting + onwards] * 2).positions[0, :, 0] / SIDE
    assert x.diff().min() > -0.003 and x.min() > 0.095 and x.max() < 0.91


@pytest.mark.parametrize("turn", [math.pi / 7, math.pi / 2, 2.5])
def test_turned_page_gives_turned_demonstrations(turn: float) -> None:
    straight, turned = demonstrations(strokes()), demonstrations(strokes(turn=turn))
    axes = torch.tensor(
        [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]], dtype=torch.float64
    )
    expected = (straight.positions - SIDE / 2) @ axes.mT + SIDE / 2
    torch.testing.assert_close(turned.positions, expected, rtol=0, atol=PIXEL)


def test_straight_line_is_timed_by_its_length_not_by_trembling_across() -> None:
    draws, lines = np.random.default_rng(0), []
    for pace in PACES:
        samples = np.array(stroke(pace))
        across = PchipInterpolator(np.linspace(0, 1, 9), draws.normal(size=9))
        samples[:, 2] = 0.5 + 0.004 * across(np.linspace(0, 1, len(samples)))
        lines.append(samples.tolist())
    assert demonstrations(lines).positions[..., 0].std(0).max() < 0.02 * SIDE


def test_files_hold_the_demonstrations_and_all_that_was_recorded(tmp_path: Path) -> None:
    recorded = read_strokes(json.dumps(strokes(jitter=1)))
    saved = save_drawing(tmp_path / "wave.npz", recorded)
    assert sorted(os.listdir(tmp_path)) == ["wave.csv", "wave.npz"]
    loaded = load_demonstrations(tmp_path / "wave.npz", time_step=0.1)
    assert torch.equal(loaded.positions, saved.positions) and loaded.names == ("x", "y")
    again = load_recordings(tmp_path / "wave.csv")
    assert again.labels == recorded.labels and again.names == recorded.names
    assert all(map(torch.equal, again.times + again.values, recorded.times + recorded.values))


def test_neither_file_is_left_where_one_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "wave.npz").mkdir()
    with pytest.raises(OSError):
        save_drawing(tmp_path / "wave.npz", read_strokes(json.dumps(strokes())))
    assert os.listdir(tmp_path) == ["wave.npz"]


FIRST, SECOND = strokes()[:2]


def second(samples: object) -> str:
    return json.dumps([FIRST, samples])


def fifth(sample: object) -> str:
    return second([*SECOND[:4], sample, *SECOND[5:]])


HARDLY_MOVING = [[10 * k, 0.5 + k / 4000, 0.5] for k in range(99)]
NUMBERS = "stroke 2, sample 5 must be three finite numbers [time, right, down], got"
REFUSED = {
    "the strokes must be JSON, got '[[1, 2' (Expecting ',' delimiter": "[[1, 2",
    "the strokes must be JSON, got b'": b"\xff\xfe\xfd",
    "the strokes must be JSON": "[" * 100000,
    "the strokes must be a list of 2 to 20, got {'strokes': []}": '{"strokes": []}',
    "the strokes must be a list of 2 to 20, got 1": json.dumps([FIRST]),
    "the strokes must be a list of 2 to 20, got 25": json.dumps(25 * [FIRST]),
    "stroke 2 must be a list of at least 10 samples, got 'drawn'": second("drawn"),
    "stroke 2 must be a list of at least 10 samples, got 9": second(SECOND[:9]),
    f"{NUMBERS} [1.0, 2.0]": fifth([1, 2]),
    f"{NUMBERS} [36.0, '0.5', 0.5]": fifth([36, "0.5", 0.5]),
    f"{NUMBERS} [36.0, None, 0.5]": fifth([36, None, 0.5]),
    f"{NUMBERS} [36.0, True, 0.5]": fifth([36, True, 0.5]),
    f"{NUMBERS} [36.0, nan, 0.5]": fifth([36, math.nan, 0.5]),
    f"{NUMBERS} [36.0, inf, 0.5]": fifth([36, 10**400, 0.5]),
    "stroke 2, sample 5 must be later than the one before, got 4321.5 after 4345.5 ms": (
        fifth([4321.5, 0.2, 0.5])
    ),
    "stroke 2, sample 5 must be inside of the square, [0, 1], got [0.2, -0.5]": (
        fifth([4350, 0.2, -0.5])
    ),
    "stroke 2 must last 0.3 to 20 s, got 0.192 s": second(stroke(PACES[0], 0.2)),
    "stroke 2 must last 0.3 to 20 s, got 29.9 s": second(stroke(PACES[0], 30, 20)),
    "stroke 2 must reach over 0.05 of the square's side": second(HARDLY_MOVING),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_no_drawing_is_refused_in_one_line(message: str) -> None:
    with pytest.raises(DrawingError) as error:
        read_strokes(REFUSED[message])
    line = str(error.value)
    assert line.startswith(message) and "\n" not in line and len(line) < 200


def test_flick_after_a_rest_and_unfit_time_step_are_refused() -> None:
    with pytest.raises(DrawingError, match=r"stroke 2 must move for 0.3 s at least, got 0\.\d+ s"):
        demonstrations([strokes()[0], stroke(PACES[0], 0.1, rests=(0.5, 0.5))])
    for step in (0.001, 0.5, math.nan):
        with pytest.raises(
            DrawingError, match=rf"the time step must be from 0.01 to 0.3 s, got {step:g} s"
        ):
            demonstrations(strokes(), step)
