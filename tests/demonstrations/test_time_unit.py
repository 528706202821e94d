"""Times that are plainly not seconds are refused with what helps, and honest ones are not."""

from __future__ import annotations

import pytest
import torch

from torch_pmil.demonstrations.time_unit import doubt_of_times

STEPS = torch.arange(200, dtype=torch.float64)
EPOCH = 1_694_012_345


@pytest.mark.parametrize(
    ("times", "period", "looks", "helps"),
    [
        (10 * STEPS, 0.1, "milliseconds", "divide it by 1000, or name the column time_ms"),
        (1.001 * STEPS, 0.1, "milliseconds", "divide it by 1000, or name the column time_ms"),
        (1.001 * torch.arange(2000), 0.5, "milliseconds", "divide it by 1000, or name the"),
        (10 * STEPS, 0.001, "milliseconds", "divide it by 1000, or name the column time_ms"),
        (EPOCH * 1e3 + 33.3 * STEPS, 0.05, "milliseconds", "divide it by 1000, or"),
        (100 * STEPS[:12], 0.1, "milliseconds", "divide it by 1000, or"),
        (500 * STEPS[:5], 0.1, "milliseconds", "divide it by 1000, or"),
        (1e4 * STEPS, 0.1, "microseconds", "divide it by 1000000, or name the column time_us"),
        (1e7 * STEPS, 0.1, "nanoseconds", "divide it by 1000000000, or name the column time_ns"),
        (EPOCH * 1e9 + 1e7 * STEPS, 1.0, "nanoseconds", "divide it by 1000000000, or"),
        (STEPS, 0.1, "frame numbers", "divide it by the frame rate in Hz (time_s if it is in"),
        (STEPS, 0.02, "frame numbers", "divide it by the frame rate in Hz (time_s if it is in"),
    ],
)
def test_unit_is_named_with_what_helps(
    times: torch.Tensor, period: float, looks: str, helps: str
) -> None:
    doubt = doubt_of_times([times, times], period)
    assert doubt.startswith(f"time looks like {looks}, not seconds: steps of ")
    assert helps in doubt


@pytest.mark.parametrize(
    ("step", "samples", "period"),
    [
        (5.0, 41, 5.0),  # an oven of 200 s
        (1.0, 201, 5.0),
        (10.0, 21, 5.0),
        (1.0, 100, 1.0),
        (0.001, 1001, 0.001),
        (1 / 30, 60, 0.001),  # a camera beside a fast robot
        (0.01, 200, 0.1),
        (0.1, 6000, 0.1),  # ten minutes
        (1.0, 5, 0.1),  # keyframes
        (1.0, 1500, 1.0),
    ],
)
@pytest.mark.parametrize("start", [0, EPOCH])
def test_slow_and_fast_motions_are_not_doubted(
    step: float, samples: int, period: float, start: float
) -> None:
    times = start + step * torch.arange(samples, dtype=torch.float64)
    assert doubt_of_times([times], period) == ""


def test_recordings_must_last_two_control_periods() -> None:
    line = "recordings of 1.99 s are shorter than two control periods of 100 s: both must be in"
    assert doubt_of_times([0.01 * STEPS], 100.0).startswith(line)


@pytest.mark.parametrize(
    ("factors", "number", "looks"),
    [
        ((1, 1e3, 1, 1, 1), 1, "milliseconds: its steps are 100, those of the others 0.1"),
        ((1, 1e6), 1, "microseconds: its steps are 1e+05, those of the others 0.1"),
        ((1e9, 1, 1), 0, "nanoseconds: its steps are 1e+08, those of the others 0.1"),
        ((1e3, 1, 1e3), 1, "seconds: its steps are 0.1, those of the others 100"),
        ((1, 1, 400), 2, "milliseconds: its steps are 40, those of the others 0.1"),
    ],
)
def test_recording_in_another_unit_than_the_others_is_named(
    factors: tuple[float, ...], number: int, looks: str
) -> None:
    times = [factor * STEPS[:21] / 10 for factor in factors]
    end = f" looks like {looks}; convert all times to seconds"
    labels = "abcde"[: len(times)]
    assert doubt_of_times(times, 0.1, labels) == f"time of demonstration {labels[number]}{end}"
    assert doubt_of_times(times, 0.1) == f"time of recording {number + 1}{end}"


@pytest.mark.parametrize("factors", [(1, 1, 50), (1, 1, 2e4), (0.01, 1, 1)])
def test_recordings_may_have_steps_of_their_own(factors: tuple[float, ...]) -> None:
    times = [factor * STEPS[:21] / 1000 for factor in factors]
    assert doubt_of_times(times, 0.001) == ""
    keyframes = [STEPS / 1000, torch.tensor([0.0, 1.0, 2.0])]
    assert doubt_of_times(keyframes, 0.001) == ""
