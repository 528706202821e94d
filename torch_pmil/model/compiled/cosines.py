"""Cosines of combinations of a state, by the formulas of :mod:`torch_pmil.gp.trigonometry`."""

from __future__ import annotations

from math import copysign, cos, exp, expm1, sin, tanh

from torch_pmil.model.compiled.building import Array1, Array2, Kernel, compiled
from torch_pmil.model.compiled.small_matrices import (
    make_symmetric,
    product,
    product_of_transpose,
    product_with_transpose,
    times_vector,
)


@compiled
def write_waves(
    rows: Array2, turns: Array1, kept: int, state: Array1, out: Array1, gain: Array1
) -> None:
    """Write combinations (R,) of a state (D,), all but ``kept`` through a cosine, and slopes."""
    times_vector(rows, state, out)
    for r in range(len(rows)):
        phase = out[r] + turns[r]
        out[r] = phase if r < kept else cos(phase)
        gain[r] = 1.0 if r < kept else -sin(phase)


@compiled
def write_phases(
    rows: Array2,
    turns: Array1,
    mean: Array1,
    cov: Array2,
    linear: Array2,
    out_mean: Array1,
    out_cov: Array2,
) -> None:
    """Write mean (R,) and covariance (R, R) of combinations of a state; scratch is (R, D)."""
    times_vector(rows, mean, out_mean)
    for r in range(len(rows)):
        out_mean[r] += turns[r]
    product(rows, cov, linear)
    product_with_transpose(linear, rows, out_cov)


@compiled
def write_cotangents(
    rows: Array2, d_phase: Array1, d_cov: Array2, linear: Array2, out_mean: Array1, out_cov: Array2
) -> None:
    """Write the cotangents of a state's mean and covariance, from those of its combinations."""
    for d in range(len(out_mean)):
        out_mean[d] = 0.0
        for r in range(len(rows)):
            out_mean[d] += rows[r, d] * d_phase[r]
    product(d_cov, rows, linear)
    product_of_transpose(rows, linear, out_cov)
    make_symmetric(out_cov)


@Kernel
def write_cosines(
    phase: Array1, cov: Array2, kept: int, out_mean: Array1, out_cov: Array2, gain: Array1
) -> bool:
    """Moments of [x_1, ..., x_kept, cos x_kept+1, ...] when x has mean ``phase`` and ``cov``.

    ``gain`` is the mean slope of each result in its entry, (R,).
    """
    size = len(phase)
    for i in range(kept):
        gain[i], out_mean[i] = 1.0, phase[i]
    for i in range(kept, size):
        decay = exp(-cov[i, i] / 2.0)
        gain[i], out_mean[i] = -decay * sin(phase[i]), decay * cos(phase[i])
    for i in range(size):
        for j in range(i + 1):
            entry = gain[i] * cov[i, j] * gain[j]
            if j >= kept:
                even, odd = _coefficients(cov, i, j)
                of_sines = odd * sin(phase[i]) * sin(phase[j])
                entry = even * cos(phase[i]) * cos(phase[j]) + of_sines
            out_cov[i, j] = out_cov[j, i] = entry
    return True


@compiled
def _coefficients(cov: Array2, i: int, j: int) -> tuple[float, float]:
    """Factors of the products of cosines and of sines in a covariance of two cosines."""
    size = abs(cov[i, j])
    growth = exp(size - (cov[i, i] + cov[j, j]) / 2.0) * expm1(-2.0 * size)
    odd = copysign(growth / 2.0, cov[i, j])
    return odd * tanh(cov[i, j] / 2.0), odd


@Kernel
def adjoint_of_cosines(
    phase: Array1,
    cov: Array2,
    kept: int,
    gain: Array1,
    d_mean: Array1,
    d_cov: Array2,
    d_gain: Array1,
    d_phase: Array1,
    d_linear: Array2,
) -> bool:
    """Cotangents of mean and covariance of x from those of the results of :func:`write_cosines`.

    ``d_cov`` must be symmetric, and ``d_gain`` is overwritten; ``d_phase`` and ``d_linear`` are the
    cotangents of ``phase`` and ``cov``.
    """
    size = len(phase)
    for i in range(size):
        for j in range(size):
            if i < kept or j < kept:
                scaled = d_cov[i, j] * gain[j]
                d_gain[i] += 2.0 * scaled * cov[i, j]
                d_linear[i, j] = scaled * gain[i]
    for i in range(kept):
        d_phase[i] = d_mean[i]
    for i in range(kept, size):
        decay, sine, cosine = exp(-cov[i, i] / 2.0), sin(phase[i]), cos(phase[i])
        by_decay = decay * (d_mean[i] * cosine - d_gain[i] * sine) / 2.0
        d_phase[i] = -decay * (d_mean[i] * sine + d_gain[i] * cosine)
        for j in range(kept, size):
            even, odd = _coefficients(cov, i, j)
            cosines, sines = cosine * cos(phase[j]), sine * sin(phase[j])
            level = even + exp(-(cov[i, i] + cov[j, j]) / 2.0)
            turned = cosine * odd * sin(phase[j]) - sine * even * cos(phase[j])
            d_phase[i] += 2.0 * d_cov[i, j] * turned
            by_decay += d_cov[i, j] * (even * cosines + odd * sines)
            d_linear[i, j] = d_cov[i, j] * (odd * cosines + level * sines)
        d_linear[i, i] -= by_decay
    return True
