"""Time alignment: timing is taken away, motion stays; what cannot be aligned is refused."""

from __future__ import annotations

import math
import re
from functools import partial

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline, PchipInterpolator
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.demonstrations.preparation.alignment import AlignmentError, align, crop, resample

STEP = 0.01  # s
VELOCITIES = [4, 5, 6, 7]


def spread(trajectories: Tensor) -> float:
    return trajectories.std(0).square().mean().sqrt().item()


def stretched(trajectories: list[Tensor]) -> Tensor:
    """To the length of the shortest one, evenly."""
    steps = min(len(one) for one in trajectories)
    even = partial(torch.nn.functional.interpolate, size=steps, mode="linear", align_corners=True)
    return torch.cat([even(one.mT[None]).mT for one in trajectories])


def shown_by_people(positions: Tensor, seed: int) -> list[Tensor]:
    """Positions (N, T, M) and their velocities at 100 Hz: time varies by 15 %, pace by half."""
    draws, shown = np.random.default_rng(seed), []
    for demonstration in positions.numpy():
        steps = int(100 * 2.5 * draws.uniform(0.85, 1.15))
        knots = np.linspace(0, 1, 6)
        pace = PchipInterpolator(knots, np.sort(knots + np.r_[0, 0.04 * draws.normal(size=4), 0]))
        motion = CubicSpline(np.linspace(0, 1, len(demonstration)), demonstration)
        times = np.linspace(0, 1, steps + 1)
        velocities = motion(pace(times), 1) * pace(times, 1)[:, None] / (steps * STEP)
        shown.append(torch.from_numpy(np.concatenate([motion(pace(times)), velocities], 1)))
    return shown


@pytest.fixture(scope="module")
def swing_ups() -> Tensor:
    return shipped_demonstrations("double_pendulum").positions


@pytest.fixture(scope="module")
def shown(swing_ups: Tensor) -> list[Tensor]:
    """Five different motions."""
    return shown_by_people(swing_ups, seed=0)


def test_identical_trajectories_stay(swing_ups: Tensor) -> None:
    same = swing_ups[:1].expand(3, -1, -1)
    torch.testing.assert_close(align(list(same)), same, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_copies_with_other_timing_are_brought_back(swing_ups: Tensor, seed: int) -> None:
    copies = shown_by_people(swing_ups[:1].expand(5, -1, -1), seed)
    aligned = align(copies, VELOCITIES)
    assert spread(stretched(copies)[..., :4]) > 0.03
    largest_step = max(copy[:, :4].diff(dim=0).abs().max().item() for copy in copies)
    assert (aligned[..., :4] - aligned[..., :4].mean(0)).abs().max() < largest_step
    assert spread(aligned[..., :4]) < 0.003


@pytest.mark.parametrize("seed", range(5))
def test_copy_that_is_late_or_slow_is_brought_back(seed: int) -> None:
    draws = np.random.default_rng(seed)
    rests, pauses = draws.integers(1, 40, size=(2, 4))
    reach = torch.linspace(0, 1, 151, dtype=torch.float64)[:, None] ** torch.tensor([2.0, 3.0])
    late = [
        torch.cat([reach[:1].expand(rest, -1), reach, reach[-1:].expand(pause, -1)])
        for rest, pause in zip(rests, pauses, strict=True)
    ]
    aligned = align(late)
    assert aligned.shape[1] == round(np.mean([len(one) - 1 for one in late])) + 1
    assert spread(stretched(late)) > 0.02
    assert spread(aligned) < 0.1 * spread(stretched(late))


@pytest.mark.parametrize("seed", range(5))
def test_spread_is_mostly_timing_and_what_is_left_is_that_of_the_motions(
    swing_ups: Tensor, seed: int
) -> None:
    shown = shown_by_people(swing_ups, seed)
    before, after = spread(stretched(shown)[..., :4]), spread(align(shown, VELOCITIES)[..., :4])
    assert after < 0.5 * before
    assert after < 1.2 * spread(swing_ups)


@pytest.mark.parametrize("seed", range(5))
def test_shipped_demonstrations_spread_less_with_each_delay(swing_ups: Tensor, seed: int) -> None:
    delays = np.random.default_rng(seed).integers(0, 4, size=5)
    delayed = [
        torch.cat([one[:1].expand(delay, -1), one])
        for one, delay in zip(swing_ups, delays, strict=True)
    ]
    assert spread(align(delayed)) <= spread(stretched(delayed))


def test_ends_stay_and_the_duration_is_the_mean(shown: list[Tensor]) -> None:
    aligned = align(shown, VELOCITIES)
    assert aligned.shape == (5, round(np.mean([len(one) - 1 for one in shown])) + 1, 8)
    for one, result in zip(shown, aligned, strict=True):
        torch.testing.assert_close(result[[0, -1], :4], one[[0, -1], :4], rtol=0, atol=1e-9)


def test_velocities_are_those_of_the_warped_positions(shown: list[Tensor]) -> None:
    aligned = align(shown, VELOCITIES)
    derived = torch.gradient(aligned[..., :4], spacing=STEP, dim=1)[0]
    difference = (aligned[..., 4:] - derived)[:, 2:-2]
    assert difference.square().mean().sqrt() < 5e-3 * derived.square().mean().sqrt()
    untold = (align(shown)[..., 4:] - derived)[:, 2:-2]
    assert untold.square().mean() > 100 * difference.square().mean()


def test_counting_from_the_end_order_and_units_do_not_matter(shown: list[Tensor]) -> None:
    aligned = align(shown, VELOCITIES)
    assert torch.equal(align(shown, [-4, -3, -2, -1]), aligned)
    order = [3, 0, 4, 2, 1]
    torch.testing.assert_close(align([shown[index] for index in order]), align(shown)[order])
    units = torch.ones(8, dtype=torch.float64)
    units[1] = 1000.0
    scaled = align([one * units for one in shown], VELOCITIES)
    torch.testing.assert_close(scaled / units, aligned, rtol=0, atol=1e-9)


@pytest.mark.parametrize("turn", [0.5, 2.0])
def test_places_on_a_page_may_be_turned(shown: list[Tensor], turn: float) -> None:
    axes = torch.tensor(
        [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]], dtype=torch.float64
    )
    places = [one[:, :2] * torch.tensor([1.0, 0.2], dtype=torch.float64) for one in shown]
    turned_places = [one @ axes for one in places]
    aligned, turned = (align(each, isotropic=True) for each in (places, turned_places))
    torch.testing.assert_close(turned, aligned @ axes, rtol=0, atol=1e-9)
    cropped, expected = (crop(each[0], isotropic=True) for each in (turned_places, places))
    torch.testing.assert_close(cropped, expected @ axes)
    by_own_spreads = align(turned_places) - align(places) @ axes
    assert by_own_spreads.abs().max() > 1e-3


def test_constant_columns_stay_and_decide_nothing(shown: list[Tensor]) -> None:
    with_constant = [torch.cat([one[:, :4], torch.full((len(one), 1), 7.0)], 1) for one in shown]
    aligned = align(with_constant)
    torch.testing.assert_close(
        aligned[..., 4], torch.full(aligned.shape[:2], 7.0, dtype=torch.float64)
    )
    torch.testing.assert_close(aligned[..., :4], align([one[:, :4] for one in shown]))


def test_one_column_is_aligned_as_it_is_among_copies_of_itself(shown: list[Tensor]) -> None:
    alone, copied = (align([one[:, columns] for one in shown]) for columns in ([0], [0, 0]))
    torch.testing.assert_close(alone, copied[..., :1], rtol=0, atol=0.02)


@pytest.mark.parametrize("reference", range(5))
def test_reference_keeps_its_timing_and_the_others_take_it_over(
    swing_ups: Tensor, reference: int
) -> None:
    copies = shown_by_people(swing_ups[:1].expand(5, -1, -1), seed=0)
    aligned = align(copies, VELOCITIES, reference=reference)
    torch.testing.assert_close(aligned[reference], copies[reference], rtol=0, atol=1e-9)
    largest_step = max(copy[:, :4].diff(dim=0).abs().max().item() for copy in copies)
    assert (aligned[..., :4] - copies[reference][:, :4]).abs().max() < 1.5 * largest_step


def test_window_limits_the_shift() -> None:
    time = torch.linspace(0, 1, 201, dtype=torch.float64)
    far = [torch.sigmoid(60 * (time - at))[:, None] for at in (0.3, 0.7)]
    free, bound = align(far, window=0.6), align(far, window=0.1)
    assert (free[0] - free[1]).abs().max() < 0.05
    assert (bound[0] - bound[1]).abs().max() > 0.5


PAIR = [torch.rand(5, 2)] * 2
NOT_FINITE = torch.tensor([[0.0], [1.0], [torch.nan]]).expand(3, 2)
SHAPE = "trajectory 1 must have shape (samples, columns) with at least 3 samples, got"
REFUSED = {
    f"{SHAPE} (5,)": ([PAIR[0], torch.rand(5)], {}),
    f"{SHAPE} (2, 2)": ([PAIR[0], torch.rand(2, 2)], {}),
    "trajectory 1 must have 2 columns like the first, got 3": ([PAIR[0], torch.rand(5, 3)], {}),
    "trajectory 1 must be finite, got nan in sample 2, column 0": ([PAIR[0], NOT_FINITE], {}),
    "reference must be the number of a trajectory, 0 to 1, got 2": (PAIR, {"reference": 2}),
    "velocities must be columns of 2, got 2": (PAIR, {"velocities": [2]}),
    "at least one of the 2 columns must be a position, got velocities [0, 1]": (
        PAIR,
        {"velocities": [0, 1]},
    ),
    "trajectories must move: every coordinate is constant": ([torch.ones(5, 2)] * 2, {}),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_aligned_is_refused(message: str) -> None:
    trajectories, arguments = REFUSED[message]
    with pytest.raises(AlignmentError) as error:
        align(trajectories, **arguments)
    assert str(error.value) == message


def test_uneven_samples_become_even_ones_and_even_ones_stay() -> None:
    steps = torch.rand(300, generator=torch.Generator().manual_seed(0)) / 100
    times = 5 + torch.cat([torch.zeros(1), steps.cumsum(0)]).double()
    values = torch.stack([times.sin(), times.cos()], -1)
    even = 5 + 0.05 * torch.arange(int((times[-1] - 5) / 0.05) + 1, dtype=torch.float64)
    expected = torch.stack([even.sin(), even.cos()], -1)
    for scale in (torch.tensor(1.0), torch.tensor([1.0, 2.0])[:, None, None]):  # one, and a batch
        found = resample(scale * values, times, 0.05)
        torch.testing.assert_close(found, scale * expected, rtol=0, atol=1e-6)
    rough, times = Draws(0).normal(26, 3), 0.1 * torch.arange(26, dtype=torch.float64)
    torch.testing.assert_close(resample(rough, times, 0.1), rough)


@pytest.mark.parametrize(
    ("samples", "times", "time_step", "message"),
    [
        (4, torch.arange(3), 1.0, "times (T,) with T >= 2, got (4, 2) and (3,)"),
        (3, torch.tensor([0.0, 2, 1]), 1.0, "times must increase, got 1 s after 2 s at sample 2"),
        (3, torch.arange(3.0), 2.5, "at most the duration, 2 s, got 2.5 s"),
        (3, torch.arange(3.0), 0.0, "at most the duration, 2 s, got 0.0 s"),
    ],
)
def test_what_cannot_be_resampled_is_refused(
    samples: int, times: Tensor, time_step: float, message: str
) -> None:
    with pytest.raises(AlignmentError, match=re.escape(message)):
        resample(torch.rand(samples, 2), times, time_step)


def test_rest_is_cut_off_but_one_sample_and_noise_of_velocities_is_no_motion(
    swing_ups: Tensor,
) -> None:
    reach = swing_ups[0, :18]
    resting = torch.cat([reach[:1].expand(9, -1), reach, reach[-1:].expand(6, -1)])
    torch.testing.assert_close(crop(resting, 0.0), reach)
    noise = Draws(0).normal(len(resting), 2)
    kept = crop(torch.cat([resting, noise], 1), 0.0, velocities=[-2, -1])
    torch.testing.assert_close(kept, torch.cat([reach, noise[9:-6]], 1))
    assert len(crop(torch.cat([resting, noise], 1), 0.0)) == len(resting)


@pytest.mark.parametrize(
    ("trajectory", "threshold", "message"),
    [
        (torch.ones(5, 2), 0.05, "trajectories must move: every coordinate is constant"),
        (PAIR[0], 1.0, r"threshold must be in \[0, 1\), got 1"),
    ],
)
def test_what_cannot_be_cropped_is_refused(
    trajectory: Tensor, threshold: float, message: str
) -> None:
    with pytest.raises(AlignmentError, match=message):
        crop(trajectory, threshold)
