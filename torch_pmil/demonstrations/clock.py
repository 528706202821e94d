"""What time stamps mean: the even ticks of a clock, from which each stamp is a little off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

EVEN = 0.02  # of a step, by which stamps may be off where they count as even
EXACT = 1e-9  # of a step, by which stamps may be off by the rounding of a program
SAME = 0.02  # relative difference of two durations that are one
JITTER = 0.3  # of a step; where stamps are farther off, they have no common clock
CERTAIN = 4.0  # standard errors of a duration
HOLE = 2.5  # usual steps: a longer one has no sample within
LONGEST_USUAL = 0.9  # quantile of the usual steps


class Clock(NamedTuple):
    """Start, end and step of a recording, s, and how far its stamps and its end may be off, s."""

    start: float
    end: float
    step: float
    jitter: float
    error: float

    def samples(self, time_step: float) -> int:
        """Number of samples at even times from the start to the end."""
        late = min(self.error / time_step, 0.5)
        return int((self.end - self.start) / time_step + late + 1e-6) + 1


def clock(times: Tensor) -> Clock:
    """The clock whose even ticks fit increasing stamps (T,) best.

    Samples may be missing. Stamps that are far from any even ticks stand for themselves. The step
    of a single stamp is NaN.

    Example:
        >>> import torch
        >>> found = clock(torch.tensor([0.0, 0.033, 0.067, 0.1, 0.133], dtype=torch.float64))
        >>> round(1 / found.step), found.jitter < 4e-4
        (30, True)
    """
    stamps = times.double().numpy()
    steps = np.diff(stamps)
    if not len(steps):
        return Clock(stamps[0], stamps[0], math.nan, 0.0, 0.0)
    ticks = np.concatenate([[0.0], np.cumsum(np.maximum(1, np.rint(steps / np.median(steps))))])
    apart, since = ticks - ticks.mean(), stamps - stamps[0]
    step = (apart @ since) / (apart @ apart)
    first = since.mean() - step * ticks.mean()
    off = since - (first + step * ticks)
    jitter = float(np.abs(off).max())
    # also the last bits of a sum of decimal fractions are no jitter
    if not EXACT * step < jitter < JITTER * step:
        return Clock(stamps[0], stamps[-1], float(np.median(steps)), jitter, 0.0)
    error = CERTAIN * float(off.std()) * ticks[-1] / math.sqrt(apart @ apart)
    error += 2 * np.spacing(np.abs(stamps).max())  # of seconds since 1970, 0.2 us each
    start = stamps[0] + first
    return Clock(start, start + step * ticks[-1], float(step), jitter, error)


def common_clock(recorded: Sequence[Tensor]) -> Clock | None:
    """The clock from 0 of recordings that began together, or None if they last differently.

    Durations may differ by a step or 2 %. The clock has the shortest one. If all recordings have
    equally many samples, only their stamps differ, and it has the mean.
    """
    clocks = [clock(times) for times in recorded]
    step = float(np.median([one.step for one in clocks]))
    ends = np.array([one.end - one.start for one in clocks])
    if np.ptp(ends) > max(step, SAME * ends.max()):
        return None
    jitter, error = (max(one[at] for one in clocks) for at in (3, 4))
    if len({len(times) for times in recorded}) > 1:
        return Clock(0.0, float(ends.min()), step, jitter, error)
    error += CERTAIN * float(ends.std()) / math.sqrt(len(ends))
    return Clock(0.0, float(ends.mean()), step, jitter, error)


def on_ticks(times: Tensor, step: float) -> bool:
    """Whether stamps (T,) are ``step`` s apart, but for 2 % of it."""
    off = times.double() - step * torch.arange(len(times))
    return bool(off.amax() - off.amin() <= 2 * EVEN * step)


def holes(times: Tensor) -> list[tuple[float, float]]:
    """Starts and ends, s, of stretches without samples, far longer than the usual step.

    Example:
        >>> import torch
        >>> holes(torch.tensor([0.0, 1.0, 2.0, 3.0, 9.0, 10.0]))
        [(3.0, 9.0)]
    """
    stamps = times.double().numpy()
    steps = np.diff(stamps)
    if not len(steps):
        return []
    longest = HOLE * np.quantile(steps, LONGEST_USUAL, method="lower")
    return [(float(stamps[i]), float(stamps[i + 1])) for i in np.flatnonzero(steps > longest)]
