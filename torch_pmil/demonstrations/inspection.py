"""A summary of recordings, and advice before training."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from torch_pmil.demonstrations.clock import EVEN, clock, on_ticks
from torch_pmil.demonstrations.dataset import TIME_STEP_TOLERANCE
from torch_pmil.demonstrations.recordings import ALIGN, Recordings
from torch_pmil.demonstrations.time_unit import doubt_of_times
from torch_pmil.demonstrations.turns import jumps_by_turns, turns_of, unwrapped, wrapping

SAMPLES = 101  # of a stretched demonstration
ROUNDING = 1e-9  # of the largest number: smaller ones are shown as 0
AGREEMENT = 0.3  # relative error of a rate of change that counts as the velocity


def describe(recordings: Recordings) -> str:
    """A summary of recordings: format, number, lengths, rate, targets, entries and their ranges.

    Example:
        >>> import torch
        >>> time = torch.linspace(0, 1, 11, dtype=torch.float64)
        >>> values = (time[:, None], 2 * time[:, None])
        >>> print(describe(Recordings(("1", "2"), (time, time), values, ("x",), format="CSV")))
        format          CSV
        demonstrations  2
        samples         11
        duration        1 s
        rate            10 Hz
        targets         none
        <BLANKLINE>
        entry  unit  least  largest  spread
        x      ?     0      2        0.409
        <BLANKLINE>
        spread: standard deviation between demonstrations of one duration, root mean square over time
    """  # noqa: E501
    clocks = [clock(times) for times in recordings.times if len(times) > 1]
    even = all(one.jitter <= EVEN * one.step for one in clocks)
    rate = f"{_range([1 / one.step for one in clocks])} Hz"
    lines = {
        "format": recordings.format,
        "demonstrations": str(len(recordings.labels)),
        "samples": _range([len(times) for times in recordings.times]),
        "duration": f"{_range(recordings.durations)} s",
        "rate": rate if even else f"{rate}, steps uneven",
        "targets": _targets(recordings),
    }
    summary = [f"{name:<16}{text}" for name, text in lines.items()]
    note = (
        "spread: standard deviation between demonstrations of one duration, root mean square over "
        "time"
    )
    return "\n".join([*summary, "", *_table(recordings), "", note])


def advice(
    recordings: Recordings, path: str, control_period: float, options: Sequence[str] = ()
) -> list[str]:
    """The steps that are missing for training, a line each.

    Args:
        recordings: of the file.
        path: of the file, for the command that aligns it.
        control_period: of the robot, in s.
        options: with which the file was read, for the same command.
    """
    unsure = not recordings.in_seconds
    doubt = doubt_of_times(recordings.times, control_period, recordings.labels) if unsure else ""
    late = [] if doubt else list(_timing(recordings, control_period))
    angles = turns_of(recordings, list(wrapping(recordings)))
    found = [*_too_few(recordings), *filter(None, [doubt]), *late]
    found += [*recordings.holes(), *jumps_by_turns(recordings)]
    continued = unwrapped(recordings, angles, {})
    velocities = [recordings.names[column] for column in velocities_of(continued)]
    if (late or (angles and not doubt)) and len(recordings.labels) > 1:
        step = ["--time-step", f"{control_period:g}"]
        out = "aligned.npz" if Path(path).name == "demonstrations.npz" else "demonstrations.npz"
        command = [*ALIGN.split(), path, out, *step, *options]
        command += ["--velocities", *velocities] if velocities else []
        command += ["--angles", *angles] if angles else []
        found.append(f"align them: {shlex.join(command)}")
    if not velocities:
        found.append(
            "positions alone, no velocities: enough where the match space observes positions"
        )
    return found


def spread(recordings: Recordings) -> np.ndarray:
    """Standard deviation between demonstrations (of one target) in each entry, (M,).

    It is the root mean square over time, after each demonstration was stretched to one duration;
    NaN if no two demonstrations have the same target.
    """
    stretched = _stretched(recordings)  # (N, SAMPLES, M)
    shown = recordings.targets
    targets = np.zeros((len(stretched), 1)) if shown is None else shown.numpy()
    owners = np.unique(targets, axis=0, return_inverse=True)[1]
    parts = [stretched[owners == owner] for owner in np.unique(owners)]
    squares = sum(((part - part.mean(0)) ** 2).sum(0) for part in parts)
    freedom = len(stretched) - len(parts)
    if not freedom:
        return np.full(len(recordings.names), math.nan)
    return np.sqrt((squares / freedom).mean(0))


def velocities_of(recordings: Recordings) -> dict[int, int]:
    """Columns that are rates of change, each with the column of its position."""
    samples = [
        (times.numpy(), values.numpy())
        for times, values in zip(recordings.times, recordings.values, strict=True)
        if len(times) > 1
    ]
    if not samples:
        return {}
    rate = np.concatenate([CubicSpline(times, values)(times, 1) for times, values in samples])
    value = np.concatenate([values for _, values in samples])
    size = np.sqrt((value**2).mean(0))
    # error of the rate of position i as velocity j
    error = np.sqrt(((rate[:, :, None] - value[:, None, :]) ** 2).mean(0))
    fits = (error < AGREEMENT * size) & (size > 0)
    return {
        int(velocity): int(error[:, velocity].argmin()) for velocity in np.flatnonzero(fits.any(0))
    }


def _too_few(recordings: Recordings) -> Iterator[str]:
    if len(recordings.labels) < 2:
        yield "one demonstration: training needs two at least, better three to five"
    if recordings.targets is not None:
        targets, counts = np.unique(recordings.targets.numpy(), axis=0, return_counts=True)
        yield from (
            f"one demonstration of target {targets[lonely].tolist()}: each needs two"
            for lonely in np.flatnonzero(counts < 2)[:1]
        )


def _timing(recordings: Recordings, control_period: float) -> Iterator[str]:
    lengths = [len(times) for times in recordings.times]
    if len(set(lengths)) > 1:
        yield f"lengths differ: {_range(lengths)} samples"
    clocks = [clock(times) for times in recordings.times if len(times) > 1]
    if not clocks:
        return
    step = float(np.median([one.step for one in clocks]))
    if not all(on_ticks(times, step) for times in recordings.times):
        steps = np.concatenate([times.diff().numpy() for times in recordings.times])
        yield f"time steps differ: {_range(steps)} s"
    if not math.isclose(step, control_period, rel_tol=TIME_STEP_TOLERANCE):
        slower = "; what is between samples will be interpolated" if step > control_period else ""
        yield (
            f"sampled every {step:.4g} s, the robot is controlled every {control_period:.4g} s"
            f"{slower}"
        )


def _stretched(recordings: Recordings) -> np.ndarray:
    """Each demonstration at ``SAMPLES`` even times from its start to its end, (N, SAMPLES, M)."""
    stretched = []
    for times, values in zip(recordings.times, recordings.values, strict=True):
        own = np.linspace(times[0].item(), times[-1].item(), SAMPLES)
        stretched.append(
            np.stack([np.interp(own, times.numpy(), column) for column in values.numpy().T], 1)
        )
    return np.stack(stretched)


def _table(recordings: Recordings) -> list[str]:
    everything = np.concatenate([values.numpy() for values in recordings.values])
    columns = np.stack([everything.min(0), everything.max(0), spread(recordings)], 1)
    numbers = np.where(
        np.abs(columns) < ROUNDING * np.abs(everything).max(0)[:, None], 0.0, columns
    )
    units = recordings.units or len(recordings.names) * ("?",)
    rows: list[tuple[str, ...]] = [("entry", "unit", "least", "largest", "spread")]
    rows += [
        (name, unit, *(f"{n:.3g}" for n in three))
        for name, unit, three in zip(recordings.names, units, numbers, strict=True)
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _targets(recordings: Recordings) -> str:
    if recordings.targets is None:
        return "none"
    return f"{len(recordings.targets.unique(dim=0))} of {', '.join(recordings.target_names)}"


def _range(numbers: Sequence[float] | np.ndarray) -> str:
    least, largest = f"{min(numbers, default=0):.4g}", f"{max(numbers, default=0):.4g}"
    return least if least == largest else f"{least} to {largest}"
