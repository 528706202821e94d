r"""Costs of predicted states in the match space, with their gradients (Eqs. 19, 23, 24 and 28).

All compare :math:`r = A\,[x, \sin(\cdot), \cos(\cdot)] + a` with a target: by the KL of a
demonstrated marginal to it, by the expected saturating cost, or, where the state has no variance,
by :math:`\tfrac12 \|r\|^2` or :math:`1 - e^{-\|r\|^2 / 2}`.
"""

from __future__ import annotations

from math import cos, exp, isnan, sin
from typing import NamedTuple

import numpy as np

from torch_pmil.model.compiled.building import (
    Address,
    Array1,
    Array2,
    Array3,
    Kernel,
    call,
    compiled,
    part,
)
from torch_pmil.model.compiled.cosines import adjoint_of_cosines, write_cosines
from torch_pmil.model.compiled.small_matrices import (
    invert,
    product,
    product_of_transpose,
    product_with_transpose,
    times_vector,
)

# how far below zero an eigenvalue of a covariance may be, of its largest variance or of one: less
# than the formulas allow, which are asked beyond
NEGLIGIBLE = 1e-6


class Observation(NamedTuple):
    """The map from a state to what is compared, at each of T steps.

    Args:
        rows, turns: linear combinations of the state, (R, D) and (R,), as in :class:`Augmentation`.
        kept: number of combinations that do not go through a cosine.
        matrix: A, (M, R).
        offset: a, (T, M).
        noise: covariance that is added to that of r, (M, M).
    """

    rows: Array2
    turns: Array1
    kept: int
    matrix: Array2
    offset: Array2
    noise: Array2


class CostWork(NamedTuple):
    """Room for the costs of one step."""

    phase: Array1
    phase_cov: Array2
    waves: Array1
    waves_cov: Array2
    gain: Array1
    residual: Array1
    cov: Array2
    inverse: Array2
    moved: Array1
    d_residual: Array1
    d_cov: Array2
    d_waves: Array1
    d_waves_cov: Array2
    d_gain: Array1
    d_phase: Array1
    d_phase_cov: Array2
    linear: Array2
    scratch: Array2
    write_cosines: Address
    adjoint_of_cosines: Address

    @classmethod
    def of(cls, observation: Observation) -> CostWork:
        """Room for these observations."""
        (M, R), D = observation.matrix.shape, observation.rows.shape[1]
        shapes = ((R,), (R, R), (R,), (R, R), (R,), (M,), (M, M), (M, M), (M,), (M,), (M, M))
        shapes += ((R,), (R, R), (R,), (R,), (R, R), (R, D), (M, R))
        arrays = (np.empty(shape) for shape in shapes)
        return cls(*arrays, write_cosines.address, adjoint_of_cosines.address)


@Kernel
def write_costs(
    observation: Observation,
    demonstrated: Array3,
    half_log_det: Array1,
    mean: Array2,
    cov: Array3,
    work: CostWork,
    costs: Array1,
    d_mean: Array2,
    d_cov: Array3,
) -> int:
    """Costs of T Gaussian states, and their gradients in these.

    Args:
        observation: of the states; its offset holds what they are compared with.
        demonstrated: covariances of the demonstrated marginals, (T, M, M), for the KL; (0, 0, 0)
            for the expected saturating cost.
        half_log_det: half the logarithms of their determinants, (T,) or (0,).
        mean, cov: states, (T, D) and (T, D, D).
        work: scratch.
        costs, d_mean, d_cov: out, (T,), (T, D) and (T, D, D).

    Returns:
        The step 1..T whose covariance has no Cholesky factor, or is none, or 0.
    """
    saturating = len(demonstrated) == 0
    for t in range(len(costs)):
        _observe(observation, t, mean[t], cov[t], work)
        if saturating and isnan(_invert_with(work.cov, NEGLIGIBLE * _largest(work.cov), work)):
            return t + 1
        log_det = _invert_with(work.cov, 1.0 if saturating else 0.0, work)
        if isnan(log_det):
            return t + 1
        times_vector(work.inverse, work.residual, work.moved)
        if saturating:
            costs[t] = _saturating_cost(log_det, work)
        else:
            costs[t] = _divergence(demonstrated[t], log_det - half_log_det[t], work)
        _adjoint_of_observation(observation, work, d_mean[t], d_cov[t])
    return 0


@part
def _observe(observation, t, mean, cov, work):
    """Mean and covariance of r into ``work``."""
    rows, phase, linear = observation.rows, work.phase, work.linear
    times_vector(rows, mean, phase)
    for r in range(len(rows)):
        phase[r] += observation.turns[r]
    product(rows, cov, linear)
    product_with_transpose(linear, rows, work.phase_cov)
    waves = (phase, work.phase_cov, observation.kept, work.waves, work.waves_cov, work.gain)
    call(work.write_cosines, waves)
    times_vector(observation.matrix, work.waves, work.residual)
    product(observation.matrix, work.waves_cov, work.scratch)
    product_with_transpose(work.scratch, observation.matrix, work.cov)
    for i in range(len(work.residual)):
        work.residual[i] += observation.offset[t, i]
        for j in range(len(work.residual)):
            work.cov[i, j] += observation.noise[i, j]


@compiled
def _invert_with(cov, variance, work):
    """:func:`invert` a covariance, to which a variance of all entries is added, into ``work``."""
    for i in range(len(cov)):
        for j in range(len(cov)):
            work.inverse[i, j] = cov[i, j]
        work.inverse[i, i] += variance
    return invert(work.inverse)


@compiled
def _largest(cov):
    """The largest variance, or one."""
    largest = 1.0
    for i in range(len(cov)):
        largest = max(largest, cov[i, i])
    return largest


@part
def _divergence(demonstrated, half_log_ratio, work):
    """KL to N(r, cov) from N(0, demonstrated) (Eq. 19); its gradients (Eqs. 23, 24)."""
    M, inverse, moved, d_cov = len(work.moved), work.inverse, work.moved, work.d_cov
    trace, distance = 0.0, 0.0
    product(inverse, demonstrated, work.cov)
    for i in range(M):
        trace += work.cov[i, i]
        distance += work.residual[i] * moved[i]
        work.d_residual[i] = moved[i]
    product(work.cov, inverse, d_cov)
    for i in range(M):
        for j in range(M):
            d_cov[i, j] = (inverse[i, j] - d_cov[i, j] - moved[i] * moved[j]) / 2.0
    return (trace + distance - M) / 2.0 + half_log_ratio


@part
def _saturating_cost(log_det, work):
    """Expected saturating cost of N(r, cov) (Eq. 28), and its gradients."""
    M, distance = len(work.moved), 0.0
    for i in range(M):
        distance += work.residual[i] * work.moved[i]
    closeness = exp(-distance / 2.0 - log_det)
    for i in range(M):
        work.d_residual[i] = closeness * work.moved[i]
        for j in range(M):
            outer = work.moved[i] * work.moved[j]
            work.d_cov[i, j] = closeness * (work.inverse[i, j] - outer) / 2.0
    return 1.0 - closeness


@part
def _adjoint_of_observation(observation, work, d_mean, d_cov):
    """Gradients in the state from those in r."""
    matrix, rows = observation.matrix, observation.rows
    for r in range(len(rows)):
        work.d_waves[r] = work.d_gain[r] = 0.0
        for i in range(len(matrix)):
            work.d_waves[r] += matrix[i, r] * work.d_residual[i]
    product(work.d_cov, matrix, work.scratch)
    product_of_transpose(matrix, work.scratch, work.d_waves_cov)
    cotangents = (work.d_waves, work.d_waves_cov, work.d_gain, work.d_phase, work.d_phase_cov)
    state = (work.phase, work.phase_cov, observation.kept, work.gain)
    call(work.adjoint_of_cosines, state + cotangents)
    product(work.d_phase_cov, rows, work.linear)
    product_of_transpose(rows, work.linear, d_cov)
    for d in range(len(d_mean)):
        d_mean[d] = 0.0
        for r in range(len(rows)):
            d_mean[d] += rows[r, d] * work.d_phase[r]


@Kernel
def write_costs_of_means(
    observation: Observation,
    roots: Array3,
    mean: Array2,
    saturating: bool,
    work: CostWork,
    costs: Array1,
    d_mean: Array2,
) -> bool:
    """Costs of T states without variance, and their gradients.

    Args:
        observation: as in :func:`write_costs`; the noise is not used.
        roots: matrices G, (T, M, M), of which r is G (A waves + a), or (1, M, M) for all.
        mean: states, (T, D).
        saturating: whether the cost is 1 - exp(-|r|^2 / 2), not |r|^2 / 2.
        work: scratch.
        costs, d_mean: out, (T,) and (T, D).
    """
    rows, matrix, waves, moved = observation.rows, observation.matrix, work.waves, work.moved
    for t in range(len(costs)):
        root = roots[t if len(roots) > 1 else 0]
        times_vector(rows, mean[t], work.phase)
        for r in range(len(rows)):
            phase = work.phase[r] + observation.turns[r]
            waves[r] = phase if r < observation.kept else cos(phase)
            work.gain[r] = 1.0 if r < observation.kept else -sin(phase)
        times_vector(matrix, waves, moved)
        for i in range(len(moved)):
            moved[i] += observation.offset[t, i]
        times_vector(root, moved, work.residual)
        half_square = 0.0
        for i in range(len(moved)):
            half_square += work.residual[i] * work.residual[i] / 2.0
        closeness = exp(-half_square) if saturating else 1.0
        costs[t] = 1.0 - closeness if saturating else half_square
        for i in range(len(moved)):
            moved[i] = 0.0
            for j in range(len(moved)):
                moved[i] += closeness * root[j, i] * work.residual[j]
        for d in range(d_mean.shape[1]):
            d_mean[t, d] = 0.0
            for r in range(len(rows)):
                of_wave = 0.0
                for i in range(len(moved)):
                    of_wave += matrix[i, r] * moved[i]
                d_mean[t, d] += of_wave * work.gain[r] * rows[r, d]
    return True
