"""Smoothing: signal and noise that pass are as its rule says; velocities are those of motions."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.demonstrations.preparation.alignment import AlignmentError
from torch_pmil.demonstrations.preparation.smoothing import smooth, velocities

PERIOD = 0.3  # s
RECORDINGS = 60


def instants(rate: float, duration: float = 8.0, jitter: float = 0.0) -> Tensor:
    times = torch.arange(0, duration, 1 / rate, dtype=torch.float64)
    return times + jitter / rate * Draws(1).uniform(0, 1, len(times))


def inner(times: Tensor) -> Tensor:
    """Samples that are far from both ends."""
    return (times > 1) & (times < times[-1] - 1)


def noise(samples: int, columns: int) -> Tensor:
    return Draws(0).normal(samples, columns)


def variance_of_velocities(dt: float) -> float:
    """Of white noise of variance 1."""
    return math.sqrt(2) * math.pi**3 * dt / (2 * PERIOD**3)


@pytest.mark.parametrize(("rate", "jitter"), [(100.0, 0.0), (250.0, 0.0), (250.0, 0.6)])
@pytest.mark.parametrize("period", [0.15, 0.3, 0.6])
def test_gain_is_that_of_the_rule_at_any_rate(period: float, rate: float, jitter: float) -> None:
    times = instants(rate, jitter=jitter)
    swing = torch.sin(2 * math.pi / period * times)[:, None]
    expected = 1 / (1 + (PERIOD / period) ** 4)
    left = smooth(swing, times, PERIOD)
    gain = (left * swing)[inner(times)].sum() / swing[inner(times)].square().sum()
    assert abs(gain - expected) < 2e-3


@pytest.mark.parametrize("rate", [100.0, 250.0])
@pytest.mark.parametrize(
    ("step", "variance"),
    [
        (smooth, lambda dt: 3 * math.sqrt(2) * math.pi * dt / (8 * PERIOD)),
        (velocities, variance_of_velocities),
    ],
)
def test_white_noise_is_left_as_stated_within_its_standard_error(
    step, variance, rate: float
) -> None:
    times = instants(rate)
    left = step(noise(len(times), RECORDINGS), times, PERIOD)[inner(times)].square().mean(0)
    # samples at 50 Hz and more hardly fold the spectrum back: 3 % of the velocities' variance lies
    # above
    tolerance = 3 * left.std() / math.sqrt(RECORDINGS) + 0.03 * variance(1 / rate)
    assert abs(left.mean() - variance(1 / rate)) < tolerance


def test_velocities_of_a_known_motion_with_noise_are_wrong_by_bias_and_noise_alone() -> None:
    """A hand's swing of 1 s with a noise of 2 mm: the mean error is the gain's, the rest noise."""
    times, std, omega = instants(100.0), 0.002, 2 * math.pi
    far = inner(times)
    swing = 0.2 * (omega * times).sin()[:, None]
    rate = 0.2 * omega * (omega * times).cos()[far, None]
    recorded = swing + std * noise(len(times), RECORDINGS)
    error = velocities(recorded, times, PERIOD)[far] - rate
    variance, mean = std**2 * variance_of_velocities(0.01), error.mean(1, keepdim=True)
    squares = (error - mean).square().mean(0) * RECORDINGS / (RECORDINGS - 1)
    tolerance = 3 * squares.std() / math.sqrt(RECORDINGS) + 0.03 * variance
    assert abs(squares.mean() - variance) < tolerance
    attenuated = rate * (1 / (1 + PERIOD**4) - 1)  # of a swing of 1 s
    assert (mean - attenuated).abs().max() < 5 * math.sqrt(variance / RECORDINGS)
    naive = torch.gradient(recorded, spacing=0.01, dim=0)[0][far] - rate
    assert naive.square().mean() > 10 * error.square().mean()


def test_straight_lines_pass_unchanged() -> None:
    times, slopes = instants(100.0, 2.0, jitter=0.5), torch.tensor([1.0, -3.0])
    line = times[:, None] * slopes + 2
    torch.testing.assert_close(smooth(line, times, 0.5), line, rtol=0, atol=1e-9)
    expected = slopes.double().expand(len(times), 2)
    torch.testing.assert_close(velocities(line, times, 0.5), expected, rtol=0, atol=1e-8)


def test_velocities_are_the_derivative_of_the_smoothed_positions() -> None:
    times = instants(500.0, 2.0)
    values = noise(len(times), 2).cumsum(0) / 50
    derived = torch.from_numpy(np.gradient(smooth(values, times, PERIOD), times, axis=0))
    error = velocities(values, times, PERIOD)[5:-5] - derived[5:-5]
    assert error.abs().max() <= 2e-3 * derived.abs().max()


DURATION = "period must be positive and at most the duration, 4 s, got"
SAMPLES = "values must be (T, M) and times (T,) with T >= 5, got"
BACK = torch.tensor([0.0, 2.0, 1.0, 3.0, 4.0])


@pytest.mark.parametrize(
    ("values", "times", "period", "message"),
    [
        (torch.rand(4, 2), torch.arange(4.0), 1.0, f"{SAMPLES} (4, 2) and (4,)"),
        (torch.rand(6, 2), torch.arange(5.0), 1.0, f"{SAMPLES} (6, 2) and (5,)"),
        (torch.full((6, 1), torch.nan), torch.arange(6.0), 1.0, "values and times must be finite"),
        (torch.rand(5, 2), BACK, 1.0, "times must increase, got 1 s after 2 s at sample 2"),
        (torch.rand(5, 2), torch.arange(5.0), 0.0, f"{DURATION} 0.0 s"),
        (torch.rand(5, 2), torch.arange(5.0), 4.5, f"{DURATION} 4.5 s"),
    ],
)
@pytest.mark.parametrize("step", [smooth, velocities])
def test_what_cannot_be_smoothed_is_refused(
    step, values: Tensor, times: Tensor, period: float, message: str
) -> None:
    with pytest.raises(AlignmentError, match=re.escape(message)):
        step(values, times, period)
