r"""Smoothing of recorded positions, and their velocities.

A cubic smoothing spline (Reinsch 1967) minimises :math:`\int (y - f)^2 \, dt + \lambda \int \ddot
f^2 \, dt` over the recording. Its gain for an oscillation of period :math:`P` is
:math:`1 / (1 + \lambda (2 \pi / P)^4)` at any sampling rate. The setting is the period in seconds
with the gain 1/2, :math:`\lambda = (\text{period} / 2 \pi)^4`. Twice that period has the gain 0.94,
half of it 0.06.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import BSpline, make_smoothing_spline
from torch import Tensor, from_numpy

from torch_pmil.demonstrations.preparation.alignment import AlignmentError, check_samples

FEWEST_SAMPLES = 5  # that a smoothing spline takes


def smooth(values: Tensor, times: Tensor, period: float) -> Tensor:
    r"""Smoothed positions (T, M), float64, at the same times.

    White noise of standard deviation :math:`\sigma` in samples :math:`\Delta t` apart is reduced to
    :math:`\sigma \sqrt{3 \sqrt 2 \, \pi \Delta t / (8\,\text{period})}`, away from the ends.

    Args:
        values: of one recording, (T, M), T >= 5.
        times: of the samples, increasing, even or not, in s, (T,).
        period: of an oscillation that is reduced to half, in s.

    Raises:
        AlignmentError: a shape is wrong, a number is not finite, times do not increase, or the
            period is not positive or longer than the recording.

    Example:
        >>> import torch
        >>> times = torch.arange(200, dtype=torch.float64) / 100
        >>> generator = torch.Generator().manual_seed(0)
        >>> noise = 0.01 * torch.randn(200, 1, generator=generator, dtype=torch.float64)
        >>> error = smooth(times[:, None] + noise, times, 0.3) - times[:, None]
        >>> bool(error.std() < 0.5 * noise.std())
        True
    """
    return from_numpy(_spline(values, times, period)(times.double().numpy()))


def velocities(values: Tensor, times: Tensor, period: float) -> Tensor:
    r"""Rates of change (T, M), per second, of the smoothed positions.

    White noise of standard deviation :math:`\sigma` in the positions gives them the standard
    deviation :math:`\sigma \sqrt{\sqrt 2 \, \pi^3 \Delta t / (2\,\text{period}^3)}`, away from the
    ends. Arguments, of unsmoothed positions, and errors are those of :func:`smooth`.

    Example:
        >>> import torch
        >>> times = torch.arange(0, 2, 0.01, dtype=torch.float64)
        >>> swing = torch.sin(torch.pi * times)[:, None]
        >>> error = velocities(swing, times, 0.2) - torch.pi * torch.cos(torch.pi * times)[:, None]
        >>> bool(error[20:-20].abs().max() < 1e-3 * torch.pi)
        True
    """
    return from_numpy(_spline(values, times, period).derivative()(times.double().numpy()))


def _spline(values: Tensor, times: Tensor, period: float) -> BSpline:
    check_samples(values, times, FEWEST_SAMPLES)
    duration = (times[-1] - times[0]).item()
    if not 0 < period <= duration:
        raise AlignmentError(
            f"period must be positive and at most the duration, {duration:g} s, got {period} s"
        )
    t = times.double().numpy()
    half = np.diff(t) / 2
    weights = np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])  # trapezoidal rule
    penalty = (period / (2 * math.pi)) ** 4
    return make_smoothing_spline(t, values.double().numpy(), w=weights, lam=penalty)
