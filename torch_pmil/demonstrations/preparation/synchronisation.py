"""Demonstrations from recordings of any length, at any times."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.clock import EXACT, Clock, clock, common_clock, on_ticks
from torch_pmil.demonstrations.dataset import TIME_STEP_TOLERANCE, Demonstrations
from torch_pmil.demonstrations.preparation.alignment import (
    WINDOW,
    AlignmentError,
    align,
    resample,
)
from torch_pmil.demonstrations.recordings import Recordings

ABOVE = 0.1  # of a control period, by which recordings may be slower than a part of it


def synchronise(
    recordings: Recordings,
    time_step: float,
    velocities: Sequence[str] = (),
    window: float | None = None,
    reference: int | None = None,
) -> Demonstrations:
    """Demonstrations of one length and one timing, at the time step of the robot, in s.

    All are sampled evenly about as often as they were recorded, aligned by :func:`align`, and then
    sampled at the robot's time step. With a window of 0 they are only sampled. That is the default
    for recordings of one duration whose stamps jitter or are at the robot's time step.
    ``velocities`` are names of entries that are rates of change; other arguments and errors are
    those of :func:`align`.

    Example:
        >>> import torch
        >>> times = [torch.arange(n, dtype=torch.float64) / 100 for n in (101, 121)]
        >>> values = [(3 * t).sin()[:, None] for t in times]
        >>> recordings = Recordings(("1", "2"), tuple(times), tuple(values), ("q",))
        >>> synchronise(recordings, time_step=0.1).positions.shape
        torch.Size([2, 12, 1])
    """
    if not 0 < time_step < math.inf:
        raise AlignmentError(
            "time_step must be positive and at most the duration, "
            f"{recordings.durations[0]:g} s, got {time_step} s"
        )
    for label, times in zip(recordings.labels, recordings.times, strict=True):
        if len(times) < 2:
            raise AlignmentError(
                f"demonstration {label} must have at least two samples, got {len(times)}"
            )
    common = common_clock(recordings.times)
    if window is None:
        in_time = reference is None and common is not None and _by_one_clock(common, time_step)
        window = 0.0 if in_time else WINDOW
    if window == 0:
        shown = _as_recorded(recordings, time_step, common)
    else:
        shown = _aligned(recordings, time_step, velocities, window, reference)
    return Demonstrations(
        shown, time_step, recordings.names, recordings.targets, recordings.target_names
    )


def _by_one_clock(common: Clock, time_step: float) -> bool:
    """Whether recordings of one duration need no alignment: at the robot's rate, or with jitter."""
    at_rate = math.isclose(common.step, time_step, rel_tol=TIME_STEP_TOLERANCE)
    return at_rate or common.jitter > EXACT * common.step


def _as_recorded(recordings: Recordings, time_step: float, common: Clock | None) -> Tensor:
    """At the robot's time step by one clock; samples that are at its ticks stay as they are."""
    if common is None:
        raise AlignmentError(
            "window must be positive for recordings of several durations, "
            f"{min(recordings.durations):g} to {max(recordings.durations):g} s, got 0"
        )
    lengths = {len(times) for times in recordings.times}
    if len(lengths) == 1 and all(on_ticks(times, time_step) for times in recordings.times):
        return torch.stack(recordings.values)
    count = common.samples(time_step)
    pairs = zip(recordings.values, recordings.times, strict=True)
    return torch.stack([resample(values, times, time_step, count) for values, times in pairs])


def _aligned(
    recordings: Recordings,
    time_step: float,
    velocities: Sequence[str],
    window: float,
    reference: int | None,
) -> Tensor:
    """Sampled about as often as they were recorded, aligned, and then at the robot's time step."""
    recorded_step = float(np.median([clock(times).step for times in recordings.times]))
    step = time_step / max(1, math.ceil(time_step / recorded_step - ABOVE))
    pairs = zip(recordings.values, recordings.times, strict=True)
    even = [resample(values, times, step) for values, times in pairs]
    columns = [recordings.names.index(name) for name in velocities]
    aligned = align(even, columns, window, reference)
    times = step * torch.arange(aligned.shape[1], dtype=torch.float64)
    return resample(aligned, times, time_step)
