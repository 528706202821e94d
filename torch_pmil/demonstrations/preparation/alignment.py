r"""Time alignment of demonstrations, since half of their spread is timing.

Dynamic time warping (Sakoe and Chiba 1978, dtaidistance) finds corresponding moments of two
demonstrations. Before it, recordings are resampled evenly and cropped to the part that moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
import torch
from dtaidistance import dtw, dtw_ndim
from torch import Tensor

from torch_pmil.demonstrations.clock import clock, holes

RESOLUTION = 400  # least number of compared samples of the longest trajectory
MOST_SAMPLES = 2**24  # of a trajectory at even times
WINDOW = 0.2  # largest shift of times, as a fraction of the longest trajectory
KNOTS = 20  # of a warp, between its ends: timing changes smoothly
# of a step off the diagonal, in spreads of the coordinates, so that time advances at rest
PENALTY = 0.05


class AlignmentError(ValueError):
    """Trajectories cannot be aligned; one line says what was expected and what came."""


def align(
    trajectories: Sequence[Tensor],
    velocities: Sequence[int] = (),
    window: float = WINDOW,
    reference: int | None = None,
    isotropic: bool = False,
) -> Tensor:
    r"""Trajectories that differ in timing and length, on one time base.

    Dynamic time warping matches each to the medoid, the one with the least sum of distances to all.
    It compares positions in units of their spread; velocities would differ in a slower copy of a
    motion. The common time of a moment is the mean of its times. The warps :math:`w_n` from common
    time to that of a demonstration are smooth and monotone cubics through ``KNOTS`` averages of the
    path. Positions are warped to :math:`x_n(w_n(s))`, velocities to :math:`\dot x_n(w_n(s)) \,
    \dot w_n(s)`. The time step changes only by rounding the duration to a whole number of steps.

    Args:
        trajectories: N of them, (T_n, M) each, at one time step.
        velocities: columns that are rates of change; negative ones count from the end.
        window: largest shift of times, as a fraction of the longest trajectory, beyond the
            difference in length.
        reference: number of the trajectory that gives timing and length; None for their means.
        isotropic: whether positions share one spread, as coordinates of one place do, so that the
            result turns with the axes.

    Returns:
        (N, T, M), float64, where T - 1 is the mean of T_n - 1, or that of the reference.

    Raises:
        AlignmentError: there are fewer than two trajectories, a shape, column or reference is
            wrong, no column is a position, a number is not finite, nothing moves, or the window is
            not in (0, 1].

    Example:
        >>> time = torch.linspace(0, 1, 101, dtype=torch.float64)
        >>> early, late = (torch.sigmoid(40 * (time - at))[:, None] for at in (0.4, 0.6))
        >>> bool((early - late).abs().max() > 0.9)
        True
        >>> one, other = align([early, late])
        >>> bool((one - other).abs().max() < 0.05)
        True
    """
    values = _checked(trajectories, window)
    if reference is not None and reference not in range(len(values)):
        raise AlignmentError(
            f"reference must be the number of a trajectory, 0 to {len(values) - 1}, got {reference}"
        )
    positions = _positions(velocities, values[0].shape[1])
    lengths = np.array([len(one) - 1 for one in values])
    refinement = max(1, round(RESOLUTION / lengths.max()))
    refined = [_refined(one[:, positions], refinement) for one in values]
    compared = _in_units_of_spread(refined, isotropic)
    settings = {"window": max(2, round(window * refinement * lengths.max())), "penalty": PENALTY}
    template = compared[_medoid(compared, settings) if reference is None else reference]
    matched = [_matched_times(template, one, settings) for one in compared]
    knots = np.stack(matched) / refinement  # (N, KNOTS + 2), samples
    knots[:, -1] = lengths
    common = knots.mean(0) if reference is None else knots[reference]
    steps = round(common[-1])
    times, scale = np.linspace(0, common[-1], steps + 1), common[-1] / steps
    aligned = [
        _warped(
            one, scipy.interpolate.PchipInterpolator(common, own), times, scale, list(velocities)
        )
        for one, own in zip(values, knots, strict=True)
    ]
    return torch.from_numpy(np.stack(aligned))


def resample(values: Tensor, times: Tensor, time_step: float, samples: int | None = None) -> Tensor:
    """Values (*batch, T', M) at even times from the first one on, by a cubic spline.

    Sampling noise is not smoothed. The last sample is less than one time step before the end of the
    recording. If the stamps only jitter, start and end are those of the clock that fits them best.
    A hole without samples is bridged by a monotone cubic, which does not overshoot.

    Args:
        values: (*batch, T, M).
        times: of the samples, increasing, in s, (T,).
        time_step: between two samples of the result, in s.
        samples: T'; by default, as many as fit into the recording. More than half a recorded step
            beyond its end, the value at half a step beyond is repeated.

    Raises:
        AlignmentError: a shape is wrong, a number is not finite, times do not increase, or the time
            step is not positive, longer than the recording, or gives too many samples.

    Example:
        >>> times = torch.tensor([0.0, 0.1, 0.25, 0.3])
        >>> resample(times[:, None], times, 0.1).flatten()
        tensor([0.0000, 0.1000, 0.2000, 0.3000], dtype=torch.float64)
    """
    values, times = values.double(), times.double()
    check_samples(values, times, 2, batch=True)
    duration = (times[-1] - times[0]).item()
    if not 0 < time_step <= duration * (1 + 1e-9):
        raise AlignmentError(
            f"time_step must be positive and at most the duration, {duration:g} s, "
            f"got {time_step} s"
        )
    if duration / time_step > MOST_SAMPLES:
        raise AlignmentError(
            f"time_step must leave at most {MOST_SAMPLES} samples of {duration:g} s, got "
            f"{time_step} s"
        )
    found = clock(times)
    count = samples or found.samples(time_step)
    stamps, numbers, half = times.numpy(), values.numpy(), found.step / 2
    even = found.start + time_step * np.arange(count)
    even = np.clip(even, stamps[0] - half, stamps[-1] + half)
    sampled = scipy.interpolate.CubicSpline(stamps, numbers, axis=-2)(even)
    for begin, end in holes(times):
        within = (begin < even) & (even < end)
        sampled[..., within, :] = scipy.interpolate.PchipInterpolator(stamps, numbers, axis=-2)(
            even[within]
        )
    return torch.from_numpy(sampled)


def check_samples(values: Tensor, times: Tensor, fewest: int, batch: bool = False) -> None:
    """Raise AlignmentError unless values (T, M) and increasing times (T,) fit and are finite."""
    fits = values.ndim == 2 or (batch and values.ndim > 2)
    if not fits or times.shape != values.shape[-2:-1] or len(times) < fewest:
        raise AlignmentError(
            f"values must be ({'*batch, ' * batch}T, M) and times (T,) with T >= {fewest}, got "
            f"{tuple(values.shape)} and {tuple(times.shape)}"
        )
    for numbers in (values, times):
        if not (finite := numbers.isfinite()).all():
            raise AlignmentError(
                f"values and times must be finite, got {numbers[~finite][0].item()}"
            )
    if (late := (times.diff() <= 0).nonzero()).numel():
        at = int(late[0])
        raise AlignmentError(
            f"times must increase, got {times[at + 1]:g} s after {times[at]:g} s at sample {at + 1}"
        )


def crop(
    trajectory: Tensor,
    threshold: float = 0.05,
    velocities: Sequence[int] = (),
    isotropic: bool = False,
) -> Tensor:
    """The part (T', M) of a trajectory that moves, with one sample at rest before and after it.

    Args:
        trajectory: at one time step, (T, M).
        threshold: speed above which it moves, as a fraction of the largest one; coordinates are in
            units of their spread.
        velocities: columns that are rates of change; they are ignored, since they are noisier.
        isotropic: whether the positions share one spread, as coordinates of one place do.

    Raises:
        AlignmentError: the shape or a column is wrong, a number is not finite, nothing moves, or
            the threshold is not in [0, 1).

    Example:
        >>> crop(torch.tensor([0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0])[:, None]).flatten()
        tensor([0., 1., 2.])
    """
    _check_trajectory("the trajectory", trajectory)
    if not 0 <= threshold < 1:
        raise AlignmentError(f"threshold must be in [0, 1), got {threshold}")
    positions = trajectory[:, _positions(velocities, trajectory.shape[1])].double().numpy()
    (scaled,) = _in_units_of_spread([positions], isotropic)
    speed = np.linalg.norm(np.diff(scaled, axis=0), axis=1)
    moving = np.flatnonzero(speed > threshold * speed.max())
    return trajectory[moving[0] : moving[-1] + 2]


def _matched_times(
    reference: np.ndarray, other: np.ndarray, settings: dict[str, float]
) -> np.ndarray:
    """Times in ``other`` that match the reference's start, the means of its parts, and its end."""
    pair = [np.squeeze(one, 1) if one.shape[1] == 1 else one for one in (reference, other)]
    path = np.array(dtw.warping_path_fast(*pair, **settings))
    matched = np.bincount(path[:, 0], path[:, 1]) / np.bincount(path[:, 0])  # the mean of a jump
    edges = np.linspace(0, len(matched) - 1, KNOTS + 1)
    cumulative = scipy.interpolate.CubicSpline(np.arange(len(matched)), matched).antiderivative()
    middles = np.diff(cumulative(edges)) / np.diff(edges)
    inner = np.maximum.accumulate(np.clip(middles, 0, len(other) - 1))
    return np.concatenate([[0.0], inner, [len(other) - 1.0]])


def _warped(
    trajectory: np.ndarray,
    warp: scipy.interpolate.PchipInterpolator,
    times: np.ndarray,
    scale: float,
    velocities: list[int],
) -> np.ndarray:
    """A trajectory at the warped times; velocities by the chain rule."""
    own = np.clip(warp(times), 0, len(trajectory) - 1)
    warped = scipy.interpolate.CubicSpline(np.arange(len(trajectory)), trajectory)(own)
    warped[:, velocities] *= scale * warp(times, 1)[:, None]
    return warped


def _medoid(trajectories: Sequence[np.ndarray], settings: dict[str, float]) -> int:
    distances = dtw_ndim.distance_matrix_fast(list(trajectories), parallel=False, **settings)
    return int(distances.sum(0).argmin())


def _refined(trajectory: np.ndarray, refinement: int) -> np.ndarray:
    steps = len(trajectory) - 1
    fine = np.linspace(0, steps, refinement * steps + 1)
    return scipy.interpolate.CubicSpline(np.arange(steps + 1), trajectory)(fine)


def _in_units_of_spread(trajectories: Sequence[np.ndarray], isotropic: bool) -> list[np.ndarray]:
    """Coordinates in units of their standard deviation, or of a common one; constant ones are 0."""
    everything = np.concatenate(trajectories)
    mean, spread = everything.mean(0), everything.std(0)
    changes = spread > 1e-9 * np.abs(everything).max(0)
    if not changes.any():
        raise AlignmentError("trajectories must move: every coordinate is constant")
    if isotropic:
        spread = np.full_like(spread, np.sqrt(np.mean(spread**2)))
    return [
        np.ascontiguousarray(np.where(changes, one - mean, 0.0) / np.where(changes, spread, 1.0))
        for one in trajectories
    ]


def _checked(trajectories: Sequence[Tensor], window: float) -> list[np.ndarray]:
    if len(trajectories) < 2:
        raise AlignmentError(f"at least two trajectories are needed, got {len(trajectories)}")
    if not 0 < window <= 1:
        raise AlignmentError(
            f"window must be in (0, 1], a fraction of the longest trajectory, got {window}"
        )
    for number, trajectory in enumerate(trajectories):
        _check_trajectory(f"trajectory {number}", trajectory)
        if trajectory.shape[1] != trajectories[0].shape[1]:
            raise AlignmentError(
                f"trajectory {number} must have {trajectories[0].shape[1]} columns like the first, "
                f"got {trajectory.shape[1]}"
            )
    return [trajectory.detach().cpu().double().numpy() for trajectory in trajectories]


def _check_trajectory(name: str, trajectory: Tensor) -> None:
    if not isinstance(trajectory, Tensor) or trajectory.is_complex():
        kind = trajectory.dtype if isinstance(trajectory, Tensor) else type(trajectory).__name__
        raise AlignmentError(f"{name} must be a tensor of real numbers, got {kind}")
    if trajectory.ndim != 2 or trajectory.shape[0] < 3 or trajectory.shape[1] < 1:
        raise AlignmentError(
            f"{name} must have shape (samples, columns) with at least 3 samples, got "
            f"{tuple(trajectory.shape)}"
        )
    for row, column in (~trajectory.isfinite()).nonzero()[:1].tolist():
        number = trajectory[row, column].item()
        raise AlignmentError(
            f"{name} must be finite, got {number} in sample {row}, column {column}"
        )


def _positions(velocities: Sequence[int], columns: int) -> list[int]:
    """Columns that are not velocities."""
    for column in velocities:
        if not -columns <= column < columns:
            raise AlignmentError(f"velocities must be columns of {columns}, got {column}")
    positions = sorted(set(range(columns)) - {column % columns for column in velocities})
    if not positions:
        raise AlignmentError(
            f"at least one of the {columns} columns must be a position, got velocities "
            f"{list(velocities)}"
        )
    return positions
