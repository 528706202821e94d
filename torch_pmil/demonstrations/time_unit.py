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
NEAR = 0.5  # decades, within which a ratio of steps is that of two units
ALIKE = 10  # times as many samples, at most, in recordings whose steps are compared


def check_times(times: Sequence[Tensor], control_period: float, labels: Sequence[str] = ()) -> None:
    """Raise DemonstrationError if times (T_n,) are plainly not seconds; labels name them."""
    if doubt := doubt_of_times(times, control_period, labels):
        raise DemonstrationError(doubt)


def doubt_of_times(
    times: Sequence[Tensor], control_period: float, labels: Sequence[str] = ()
) -> str:
    """Why times (T_n,) do not look like seconds, and what to do about it; empty if they do.

    A recording is doubted first if its steps are a unit's multiple of those of the others. Its
    label names it, or else its number, from 1 on.

    Samples many control periods apart are doubted, unless they are a few keyframes, and so are
    recordings shorter than two control periods. The unit is a guess by the size of the steps.

    Example:
        >>> doubt_of_times([10 * torch.arange(200)], 0.1)[:64]
        'time looks like milliseconds, not seconds: steps of 10 where the'
        >>> doubt_of_times([0.01 * torch.arange(200)], 0.1)
        ''
        >>> seconds = torch.arange(20) / 10
        >>> doubt_of_times([seconds, seconds, 1000 * seconds], 0.1, ("a", "b", "c"))[:48]
        'time of demonstration c looks like milliseconds:'
    """
    if doubt := _doubt_of_one(times, labels):
        return doubt
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


def _doubt_of_one(times: Sequence[Tensor], labels: Sequence[str]) -> str:
    """Why the unit of one recording is not that of the others; empty if all are alike."""
    medians = [one.diff().double().median().item() if len(one) > 1 else 0.0 for one in times]
    usual = sorted(filter(None, medians))
    if not usual:
        return ""
    typical = usual[(len(usual) - 1) // 2]
    samples = len(times[medians.index(typical)])
    for number, (one, step) in enumerate(zip(times, medians, strict=True)):
        decades = math.log10(step / typical) if step else 0.0
        power = round(decades / 3)
        alike = samples <= ALIKE * len(one) and len(one) <= ALIKE * samples
        if not alike or not 0 < abs(power) <= len(UNITS) or abs(decades - 3 * power) > NEAR:
            continue
        name = f"demonstration {labels[number]}" if labels else f"recording {number + 1}"
        return (
            f"time of {name} looks like {UNITS[power - 1] if power > 0 else 'seconds'}: its steps "
            f"are {step:.4g}, those of the others {typical:.4g}; convert all times to seconds"
        )
    return ""
