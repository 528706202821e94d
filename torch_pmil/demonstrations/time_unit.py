"""Whether the times of recordings can be seconds, for a robot of that control period."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_pmil.demonstrations.errors import DemonstrationError

SLOW = 0.5  # s between samples at least: faster ones are not doubted
COARSE, SAMPLES = 5, 10  # control periods between samples, in as many samples: fewer are keyframes
COARSE_LONG, LONG = 1.5, 1000  # the same, in a recording of more control periods than that
UNITS = ("milliseconds", "microseconds", "nanoseconds")
NAMES = ("time_ms", "time_us", "time_ns")


def check_times(times: Sequence[Tensor], control_period: float) -> None:
    """Raise DemonstrationError if times (T_n,) are plainly not seconds."""
    if doubt := doubt_of_times(times, control_period):
        raise DemonstrationError(doubt)


def doubt_of_times(times: Sequence[Tensor], control_period: float) -> str:
    """Why times (T_n,) do not look like seconds, and what to do about it; empty if they do.

    Samples many control periods apart are doubted, unless they are a few keyframes, and so are
    recordings shorter than two control periods. The unit is a guess by the size of the steps.

    Example:
        >>> doubt_of_times([10 * torch.arange(200)], 0.1)[:64]
        'time looks like milliseconds, not seconds: steps of 10 where the'
        >>> doubt_of_times([0.01 * torch.arange(200)], 0.1)
        ''
    """
    steps = torch.cat([one.diff() for one in times]).double()
    if not len(steps):
        return ""
    step, samples = steps.median().item(), max(map(len, times))
    duration = max((one[-1] - one[0]).item() for one in times)
    if duration < 2 * control_period:
        return (
            f"recordings of {duration:g} s are shorter than two control periods of "
            f"{control_period:g} s: both must be in seconds"
        )
    coarse = samples >= SAMPLES and step >= COARSE * control_period
    coarse |= duration > LONG * control_period and step >= COARSE_LONG * control_period
    if step < SLOW or not coarse:
        return ""
    power = min(max(math.floor(math.log(step, 1000)), 0), len(UNITS) - 1)
    frames = bool((steps == 1).all())
    looks = "frame numbers" if frames else UNITS[power]
    divisor = "the frame rate in Hz" if frames else f"{1000 ** (power + 1)}"
    named = "" if frames else f", or name the column {NAMES[power]} in a CSV file"
    return (
        f"time looks like {looks}, not seconds: steps of {step:.6g} where the robot acts every "
        f"{control_period:g} s; divide it by {divisor}{named} (time_s if it is in seconds)"
    )
