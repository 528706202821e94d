"""Strokes that a person drew on a page, as demonstrations of one timing.

A page sends times and positions of the pen, in fractions of a square of ``SIDE`` metres. x points
right and y up from its lower left corner.
"""

from __future__ import annotations

import csv
import json
import math
import os
from pathlib import Path
from reprlib import repr as short

import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfiltfilt
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations, Recordings
from torch_pmil.demonstrations.preparation.alignment import align, crop, resample
from torch_pmil.files import replacing

SIDE = 0.3  # m, of the square
NAMES = ("x", "y")
LEAST_SAMPLES = 10  # of a stroke
SHORTEST, LONGEST = 0.3, 20.0  # s, of a stroke
LEAST_EXTENT = 0.05  # of the square's side, of a stroke in its longer direction
MOST_STROKES = 20
STEP = 0.01  # s, of the samples that are smoothed, compared and aligned
CUTOFF = 10.0  # Hz, of the smoothing: keeps the motion of a hand, not the steps between pixels
REST = 0.1  # of the largest speed: below it a pen only trembles


class DrawingError(ValueError):
    """Strokes are malformed; one line says which stroke, what was expected and what came."""


def read_strokes(text: str | bytes) -> Recordings:
    """Recordings of x and y, in m, over s from the start of each stroke.

    Args:
        text: JSON, a list of strokes, each a list of samples [time, right, down]: ms, and fractions
            of the square's side from its upper left corner.

    Raises:
        DrawingError: not JSON of this form, fewer than two strokes, a stroke with too few samples,
            too short or long, or outside of the square, a number that is not finite, or times that
            do not increase.

    Example:
        >>> stroke = [[16 * k, k / 40, 0.5] for k in range(41)]
        >>> strokes = read_strokes(json.dumps([stroke, stroke]))
        >>> strokes.times[0][-1].item(), strokes.values[0][-1].tolist()
        (0.64, [0.3, 0.15])
    """
    try:
        strokes = json.loads(text, parse_int=float)
    except (ValueError, RecursionError) as error:
        raise DrawingError(f"the strokes must be JSON, got {short(text)} ({error})") from error
    if not isinstance(strokes, list) or not 2 <= len(strokes) <= MOST_STROKES:
        came = f"{len(strokes)}" if isinstance(strokes, list) else short(strokes)
        raise DrawingError(f"the strokes must be a list of 2 to {MOST_STROKES}, got {came}")
    tables = [_checked(stroke, number) for number, stroke in enumerate(strokes, start=1)]
    return Recordings(
        labels=tuple(str(number) for number in range(1, len(tables) + 1)),
        times=tuple((table[:, 0] - table[0, 0]) / 1000 for table in tables),
        values=tuple(SIDE * torch.stack([table[:, 1], 1 - table[:, 2]], 1) for table in tables),
        names=NAMES,
    )


def drawn_demonstrations(strokes: Recordings, time_step: float = 0.1) -> Demonstrations:
    """Demonstrations of the drawn shape: one length, one timing, even samples.

    Each stroke is sampled evenly, smoothed and cut to the part that moves. All are aligned by
    dynamic time warping on distances on the page. Their duration is the mean duration, rounded to a
    whole number of time steps.

    Args:
        strokes: from :func:`read_strokes`.
        time_step: of the demonstrations, the robot's control period, in s.

    Raises:
        DrawingError: the time step is out of range, or a stroke moves for too short a time.
        AlignmentError: the strokes cannot be aligned.

    Example:
        >>> moments = torch.linspace(0, 1, 61, dtype=torch.float64)
        >>> path = 0.2 * torch.stack([moments, moments.square()], 1)
        >>> strokes = Recordings(("1", "2"), (moments, 1.2 * moments), (path, path), NAMES)
        >>> drawn_demonstrations(strokes).positions.shape
        torch.Size([2, 12, 2])
    """
    check_time_step(time_step)
    moving = [
        _moving(*stroke)
        for stroke in zip(strokes.labels, strokes.times, strokes.values, strict=True)
    ]
    aligned = align(moving, isotropic=True)
    steps = round((aligned.shape[1] - 1) * STEP / time_step)
    times = torch.linspace(0, steps * time_step, aligned.shape[1], dtype=torch.float64)
    return Demonstrations(resample(aligned, times, time_step), time_step, strokes.names)


def save_drawing(
    path: str | os.PathLike[str], strokes: Recordings, time_step: float = 0.1
) -> Demonstrations:
    """Write demonstrations to an NPZ file and their strokes to a CSV file beside it, or neither.

    Returns the demonstrations. Arguments and errors are those of :func:`drawn_demonstrations`;
    OSError if the folder is missing or not writable.
    """
    demonstrations = drawn_demonstrations(strokes, time_step)
    with replacing(Path(path).with_suffix(".csv")) as temporary:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("demonstration", "time", *strokes.names))
            for label, times, values in zip(
                strokes.labels, strokes.times, strokes.values, strict=True
            ):
                writer.writerows(
                    (label, *sample) for sample in torch.column_stack([times, values]).tolist()
                )
        demonstrations.save(path)
    return demonstrations


def check_time_step(time_step: float) -> None:
    """Raise DrawingError unless strokes can have this time step, in s."""
    if not STEP <= time_step <= SHORTEST:
        raise DrawingError(
            f"the time step must be from {STEP:g} to {SHORTEST:g} s, got {time_step:g} s"
        )


def _checked(stroke: object, number: int) -> Tensor:
    """The samples of a stroke, (T, 3)."""
    if not isinstance(stroke, list) or len(stroke) < LEAST_SAMPLES:
        came = f"{len(stroke)}" if isinstance(stroke, list) else short(stroke)
        raise DrawingError(
            f"stroke {number} must be a list of at least {LEAST_SAMPLES} samples, got {came}"
        )
    for at, sample in enumerate(stroke, start=1):
        if not _is_sample(sample):
            raise DrawingError(
                f"stroke {number}, sample {at} must be three finite numbers [time, right, down], "
                f"got {short(sample)}"
            )
    table = torch.tensor(stroke, dtype=torch.float64)
    if (late := (table[:, 0].diff() <= 0).nonzero()).numel():
        at = int(late[0])
        raise DrawingError(
            f"stroke {number}, sample {at + 2} must be later than the one before, got "
            f"{table[at + 1, 0]:g} after {table[at, 0]:g} ms"
        )
    _check_size(table, number)
    return table


def _is_sample(sample: object) -> bool:
    return (
        isinstance(sample, list)
        and len(sample) == 3
        and all(isinstance(value, float) and math.isfinite(value) for value in sample)
    )


def _check_size(table: Tensor, number: int) -> None:
    duration = (table[-1, 0] - table[0, 0]).item() / 1000
    if not SHORTEST <= duration <= LONGEST:
        raise DrawingError(
            f"stroke {number} must last {SHORTEST:g} to {LONGEST:g} s, got {duration:.3g} s"
        )
    if (outside := ((table[:, 1:] < 0) | (table[:, 1:] > 1)).any(1).nonzero()).numel():
        at = int(outside[0])
        raise DrawingError(
            f"stroke {number}, sample {at + 1} must be inside of the square, [0, 1], got "
            f"{table[at, 1:].tolist()}"
        )
    extent = (table.amax(0) - table.amin(0))[1:].amax().item()
    if extent < LEAST_EXTENT:
        raise DrawingError(
            f"stroke {number} must reach over {LEAST_EXTENT:g} of the square's side at least, got "
            f"{extent:.2g}"
        )


def _moving(label: str, times: Tensor, values: Tensor) -> Tensor:
    """The part of a stroke that moves, smoothed, at ``STEP``, (T, 2).

    A page gets no samples while the pen rests; a spline that does not overshoot bridges the gap.
    """
    even = np.linspace(0, times[-1].item(), round(times[-1].item() / STEP) + 1)
    sampled = PchipInterpolator(times.numpy(), values.numpy())(even)
    low_pass = butter(2, CUTOFF, fs=1 / STEP, output="sos")
    smooth = torch.from_numpy(sosfiltfilt(low_pass, sampled, axis=0).copy())
    moving = crop(smooth, REST, isotropic=True)
    duration = STEP * (len(moving) - 1)
    if duration < SHORTEST:
        raise DrawingError(
            f"stroke {label} must move for {SHORTEST:g} s at least, got {duration:.2g} s"
        )
    return moving
