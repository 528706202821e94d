"""Demonstrations from recordings of any length, at any times."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torch_pmil.demonstrations.dataset import Demonstrations
from torch_pmil.demonstrations.preparation.alignment import align, resample
from torch_pmil.demonstrations.recordings import Recordings


def synchronise(
    recordings: Recordings,
    time_step: float,
    velocities: Sequence[str] = (),
    window: float = 0.2,
    reference: int | None = None,
) -> Demonstrations:
    """Demonstrations of one length and one timing, at the time step of the robot, in s.

    All are sampled at the median recorded time step, aligned by :func:`align`, and then sampled at
    the robot's. ``velocities`` are names of entries that are rates of change; other arguments and
    errors are those of :func:`align`.

    Example:
        >>> import torch
        >>> times = [torch.arange(n, dtype=torch.float64) / 100 for n in (101, 121)]
        >>> values = [(3 * t).sin()[:, None] for t in times]
        >>> recordings = Recordings(("1", "2"), tuple(times), tuple(values), ("q",))
        >>> synchronise(recordings, time_step=0.1).positions.shape
        torch.Size([2, 12, 1])
    """
    recorded_step = torch.cat([times.diff() for times in recordings.times]).median().item()
    even = [
        resample(values, times, recorded_step)
        for times, values in zip(recordings.times, recordings.values, strict=True)
    ]
    columns = [recordings.names.index(name) for name in velocities]
    aligned = align(even, columns, window, reference)
    times = recorded_step * torch.arange(aligned.shape[1], dtype=torch.float64)
    return Demonstrations(
        resample(aligned, times, time_step),
        time_step,
        recordings.names,
        recordings.targets,
        recordings.target_names,
    )
