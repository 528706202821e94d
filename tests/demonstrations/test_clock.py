"""Time stamps that are rounded, jitter or leave holes lose no sample and change no value."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from torch import Tensor

from torch_pmil.demonstrations import Recordings
from torch_pmil.demonstrations.preparation.alignment import AlignmentError, resample
from torch_pmil.demonstrations.preparation.synchronisation import synchronise

RATES, PERIODS = (10, 24, 30, 50, 100), (0.1, 0.05, 1 / 30, 0.07)
OFFSETS = {"0 s": 0.0, "12.3 s": 12.3, "since 1970": 1.7e9}
STAMPS = {  # largest jitter, in steps; digits
    "exact": (0.0, 12),
    "three decimals": (0.0, 3),
    "1 us": (1e-5, 12),
    "5 %": (0.05, 12),
    "20 %": (0.2, 12),
}


def stamped(rate: int, duration: float, stamps: str, seed: int = 0) -> np.ndarray:
    jitter, digits = STAMPS[stamps]
    times = np.arange(round(rate * duration) + 1) / rate
    moved = times + np.random.default_rng(seed).uniform(-1, 1, len(times)) * jitter / rate
    return np.round(moved, digits)


def sampled(times: np.ndarray, offset: float, period: float) -> Tensor:
    values = torch.from_numpy(np.sin(2 * times))[:, None]
    return resample(values, torch.from_numpy(times + offset), period)[:, 0]


@pytest.mark.parametrize("stamps", STAMPS)
@pytest.mark.parametrize("offset", OFFSETS.values(), ids=OFFSETS)
def test_no_stamp_loses_the_last_sample_and_values_are_those_of_the_motion(
    stamps: str, offset: float
) -> None:
    for rate, duration, period in itertools.product(RATES, (2.0, 7.0), PERIODS):
        if stamps == "20 %" and period < 1 / rate:
            continue  # the end is known to a period
        shown = sampled(stamped(rate, duration, stamps), offset, period)
        count = int(duration / period + 1e-9) + 1
        assert len(shown) == count, (rate, duration, period)
        # rounding moves a stamp by 0.5 ms, fitting ends by the jitter, at speeds of at most 2
        allowed = (
            2 * (0.5e-3 * (stamps == "three decimals") + STAMPS[stamps][0] / rate) + 2e-3 / rate
        )
        expected = torch.sin(2 * period * torch.arange(count, dtype=torch.float64))
        assert (shown - expected).abs().max() < allowed, (rate, duration, period)


def test_stamps_in_single_precision_lose_nothing() -> None:
    for rate, start in itertools.product(RATES, (0.0, 12.3, 500.0)):
        times = (start + stamped(rate, 2.0, "exact")).astype(np.float32)
        assert len(sampled(times.astype(np.float64), 0.0, 0.1)) == 21


def recordings(*times: np.ndarray, size: float = 0.1) -> Recordings:
    motions = [np.sin(2 * one) * (1 + size * number) for number, one in enumerate(times)]
    values = tuple(torch.from_numpy(one)[:, None] for one in motions)
    labels = tuple(map(str, range(len(times))))
    return Recordings(labels, tuple(map(torch.from_numpy, times)), values, ("q",))


@pytest.mark.parametrize("rate", [10, 30, 100])
@pytest.mark.parametrize("stamps", ["1 us", "5 %", "20 %"])
def test_recordings_that_only_jitter_are_resampled_and_not_warped(rate: int, stamps: str) -> None:
    made = recordings(*(stamped(rate, 2.0, stamps, seed) for seed in range(5)))
    shown = synchronise(made, 0.1).positions[..., 0]
    motion = torch.sin(0.2 * torch.arange(21, dtype=torch.float64))
    expected = (1 + 0.1 * torch.arange(5.0))[:, None] * motion
    assert shown.shape == (5, 21)
    assert (shown - expected).abs().max() < 3 * max(STAMPS[stamps][0], 0.01) / rate + 1e-3


def test_steps_that_wander_lose_no_sample() -> None:
    steps = 0.01 * (1 + 0.1 * np.random.default_rng(0).standard_normal((5, 200)))
    times = np.concatenate([np.zeros((5, 1)), steps.cumsum(1)], 1)
    shown = synchronise(recordings(*times, size=0.0), 0.1).positions
    assert shown.shape == (5, 21, 1) and shown.std(0).max() < 0.05


def test_stamps_of_the_robots_clock_leave_every_value_as_it_was_recorded() -> None:
    made = recordings(*(1.7e9 + stamped(10, 2.0, "exact") for _ in range(3)))
    assert torch.equal(synchronise(made, 0.1).positions, torch.stack(made.values))
    assert torch.equal(made.demonstrations().positions, torch.stack(made.values))


def reach(times: np.ndarray) -> np.ndarray:
    """300 mm in 2 s."""
    s = times / 2
    return 300 * (10 * s**3 - 15 * s**4 + 6 * s**5)


@pytest.mark.parametrize("begin", [0.1, 0.7, 1.35])
def test_hole_is_bridged_without_overshoot(begin: float) -> None:
    times = np.arange(201) / 100
    kept = times[(times <= begin) | (times >= begin + 0.6)]
    noise = np.random.default_rng(0).normal(size=len(kept))
    shown = resample(torch.from_numpy(reach(kept) + noise)[:, None], torch.from_numpy(kept), 0.01)
    before, after = reach(np.array([begin, begin + 0.6])) + np.array([-3, 3])
    within = shown[round(100 * begin) : round(100 * begin) + 61]
    assert before <= within.min() and within.max() <= after
    assert abs(shown[:, 0].numpy() - reach(times)).max() < 30


def test_recording_of_one_sample_is_no_motion() -> None:
    made = recordings(stamped(10, 2.0, "exact"), np.zeros(1))
    message = "demonstration 1 must have at least two samples, got 1"
    with pytest.raises(AlignmentError, match=message):
        synchronise(made, 0.1)
