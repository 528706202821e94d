r"""Costs of predicted states in the match space, with their gradients (Eqs. 19, 23, 24 and 28).

They are those of :math:`r = A\,[x, \sin(\cdot), \cos(\cdot)] + a`: the KL of a demonstrated
marginal, the cross-entropy relative to it, the expected saturating cost, or, without variance,
:math:`\tfrac12 \|r\|^2` and :math:`1 - e^{-\|r\|^2 / 2}`.
"""

from __future__ import annotations

from math import exp, isnan, log, pi
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
from torch_pmil.model.compiled.cosines import (
    adjoint_of_cosines,
    write_cosines,
    write_cotangents,
    write_phases,
    write_waves,
)
from torch_pmil.model.compiled.small_matrices import (
    copy,
    invert,
    product,
    product_of_transpose,
    product_with_transpose,
    times_vector,
)

# A negative eigenvalue of a covariance up to this share of its largest variance, or of one, counts
# as rounding. Larger ones are left to the formulas in PyTorch, which allow more
NEGLIGIBLE = 1e-6


class Observation(NamedTuple):
    """The map from a state to what is compared, at each of T steps."""

    rows: Array2  # linear combinations of the state, (R, D), as in `Augmentation`
    turns: Array1  # (R,)
    kept: int  # number of combinations that do not go through a cosine
    matrix: Array2  # A, (M, R)
    offset: Array2  # a, (T, M)
    noise: Array2  # covariance that is added to that of r, (M, M)


Shapes = tuple[tuple[int, ...], ...]


class CostWork(NamedTuple):
    """Arrays for the cost of one step; a name ``d_x`` is the cotangent of x."""

    phase: Array1  # the R combinations of the state, (R,)
    phase_cov: Array2
    waves: Array1  # these, with cosines taken, (R,)
    waves_cov: Array2
    gain: Array1  # mean slope of each of them in its combination, (R,)
    residual: Array1  # r, (M,)
    cov: Array2
    inverse: Array2  # of cov, plus the identity for the saturating cost, (M, M)
    moved: Array1  # the inverse times r, (M,)
    d_residual: Array1
    d_cov: Array2
    d_waves: Array1
    d_waves_cov: Array2
    d_gain: Array1
    d_phase: Array1
    d_phase_cov: Array2
    linear: Array2  # scratch, (R, D)
    scratch: Array2  # (M, R)
    write_cosines: Address
    adjoint_of_cosines: Address

    @classmethod
    def of(cls, observation: Observation) -> CostWork:
        """Room for these observations."""
        (M, R), D = observation.matrix.shape, observation.rows.shape[1]
        of_waves: Shapes = (R,), (R, R), (R,), (R, R), (R,)
        of_residual: Shapes = (M,), (M, M), (M, M), (M,), (M,), (M, M)
        of_cotangents: Shapes = (R,), (R, R), (R,), (R,), (R, R), (R, D), (M, R)
        arrays = map(np.empty, (*of_waves, *of_residual, *of_cotangents))
        return cls._make((*arrays, write_cosines.address, adjoint_of_cosines.address))


@Kernel
def write_costs(
    observation: Observation,
    demonstrated: Array3,
    half_log_det: Array1,
    cross_entropy: bool,
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
        demonstrated: covariances (T, M, M), for the KL; (0, 0, 0) for the saturating cost.
        half_log_det: half the logarithms of their determinants, (T,) or (0,).
        cross_entropy: whether the cost is that, in place of the KL.
        mean, cov: states, (T, D) and (T, D, D).
        costs, d_mean, d_cov: out, (T,), (T, D) and (T, D, D).

    Returns:
        The step 1..T whose covariance is not valid, or 0.
    """
    saturating = len(demonstrated) == 0
    residual, cov_of_residual, inverse = work.residual, work.cov, work.inverse
    for t in range(len(costs)):
        _observe(observation, t, mean[t], cov[t], work)
        negligible = NEGLIGIBLE * _largest(cov_of_residual)
        if saturating and isnan(_invert_with(cov_of_residual, negligible, inverse)):
            return t + 1
        log_det = _invert_with(cov_of_residual, 1.0 if saturating else 0.0, inverse)
        if isnan(log_det):
            return t + 1
        if cross_entropy:
            log_det = _invert_with(demonstrated[t], 0.0, inverse)
        times_vector(inverse, residual, work.moved)
        if saturating:
            costs[t] = _saturating_cost(log_det, work)
        elif cross_entropy:
            costs[t] = _cross_entropy(log_det, work)
        else:
            costs[t] = _divergence(demonstrated[t], log_det - half_log_det[t], work)
        _adjoint_of_observation(observation, work, d_mean[t], d_cov[t])
    return 0


@part
def _observe(observation: Observation, t: int, mean: Array1, cov: Array2, work: CostWork) -> None:
    """Mean and covariance of r into ``work``, and of what it is made of."""
    rows, turns, phase, linear = observation.rows, observation.turns, work.phase, work.linear
    matrix, offset, noise = observation.matrix, observation.offset[t], observation.noise
    waves_cov, residual, cov_of_residual = work.waves_cov, work.residual, work.cov
    write_phases(rows, turns, mean, cov, linear, phase, work.phase_cov)
    waves = (phase, work.phase_cov, observation.kept, work.waves, waves_cov, work.gain)
    call(work.write_cosines, waves)
    times_vector(matrix, work.waves, residual)
    product(matrix, waves_cov, work.scratch)
    product_with_transpose(work.scratch, matrix, cov_of_residual)
    for i in range(len(residual)):
        residual[i] += offset[i]
        for j in range(len(residual)):
            cov_of_residual[i, j] += noise[i, j]


@compiled
def _invert_with(cov: Array2, variance: float, inverse: Array2) -> float:
    """:func:`invert` a covariance, to which a variance of all entries is added."""
    copy(cov, inverse)
    for i in range(len(cov)):
        inverse[i, i] += variance
    return invert(inverse)


@compiled
def _largest(cov: Array2) -> float:
    """The largest variance, or one."""
    largest = 1.0
    for i in range(len(cov)):
        largest = max(largest, cov[i, i])
    return largest


@part
def _divergence(demonstrated: Array2, half_log_ratio: float, work: CostWork) -> float:
    """KL to N(r, cov) from N(0, demonstrated) (Eq. 19); its gradients (Eqs. 23, 24)."""
    inverse, moved, residual, ratio = work.inverse, work.moved, work.residual, work.cov
    d_residual, d_cov, M = work.d_residual, work.d_cov, len(work.moved)
    trace, distance = 0.0, 0.0
    product(inverse, demonstrated, ratio)
    for i in range(M):
        trace += ratio[i, i]
        distance += residual[i] * moved[i]
        d_residual[i] = moved[i]
    product(ratio, inverse, d_cov)
    for i in range(M):
        for j in range(M):
            d_cov[i, j] = (inverse[i, j] - d_cov[i, j] - moved[i] * moved[j]) / 2.0
    return (trace + distance - M) / 2.0 + half_log_ratio


@part
def _cross_entropy(half_log_det: float, work: CostWork) -> float:
    """Cross-entropy of N(r, cov) relative to N(0, demonstrated), and its gradients."""
    inverse, moved, residual, cov = work.inverse, work.moved, work.residual, work.cov
    d_residual, d_cov, M = work.d_residual, work.d_cov, len(work.moved)
    total = M * log(2.0 * pi)
    for i in range(M):
        total += residual[i] * moved[i]
        d_residual[i] = moved[i]
        for j in range(M):
            total += inverse[i, j] * cov[j, i]
            d_cov[i, j] = inverse[i, j] / 2.0
    return total / 2.0 + half_log_det


@part
def _saturating_cost(log_det: float, work: CostWork) -> float:
    """Expected saturating cost of N(r, cov) (Eq. 28), and its gradients."""
    inverse, moved, residual = work.inverse, work.moved, work.residual
    d_residual, d_cov, M, distance = work.d_residual, work.d_cov, len(work.moved), 0.0
    for i in range(M):
        distance += residual[i] * moved[i]
    closeness = exp(-distance / 2.0 - log_det)
    for i in range(M):
        d_residual[i] = closeness * moved[i]
        for j in range(M):
            d_cov[i, j] = closeness * (inverse[i, j] - moved[i] * moved[j]) / 2.0
    return 1.0 - closeness


@part
def _adjoint_of_observation(
    observation: Observation, work: CostWork, d_mean: Array1, d_cov: Array2
) -> None:
    """Gradients in the state from those in r."""
    matrix, rows = observation.matrix, observation.rows
    d_residual, d_phase = work.d_residual, work.d_phase
    d_waves, d_gain, d_phase_cov = work.d_waves, work.d_gain, work.d_phase_cov
    for r in range(len(rows)):
        d_waves[r] = d_gain[r] = 0.0
        for i in range(len(matrix)):
            d_waves[r] += matrix[i, r] * d_residual[i]
    product(work.d_cov, matrix, work.scratch)
    product_of_transpose(matrix, work.scratch, work.d_waves_cov)
    state = work.phase, work.phase_cov, observation.kept, work.gain
    cotangents = d_waves, work.d_waves_cov, d_gain, d_phase, d_phase_cov
    call(work.adjoint_of_cosines, state + cotangents)
    write_cotangents(rows, d_phase, d_phase_cov, work.linear, d_mean, d_cov)


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

    Arguments are as in :func:`write_costs`, but r = G (A waves + a) with ``roots`` G (T, M, M), and
    the cost is r'r / 2, or 1 - exp(-r'r / 2) if ``saturating``.
    """
    rows, turns, kept = observation.rows, observation.turns, observation.kept
    matrix, offset, waves, gain = observation.matrix, observation.offset, work.waves, work.gain
    unscaled, residual = work.moved, work.residual
    for t in range(len(costs)):
        root = roots[t]
        write_waves(rows, turns, kept, mean[t], waves, gain)
        times_vector(matrix, waves, unscaled)
        for i in range(len(unscaled)):
            unscaled[i] += offset[t, i]
        times_vector(root, unscaled, residual)
        half_square = 0.0
        for i in range(len(residual)):
            half_square += residual[i] * residual[i] / 2.0
        closeness = exp(-half_square) if saturating else 1.0
        costs[t] = 1.0 - closeness if saturating else half_square
        d_unscaled = unscaled
        for i in range(len(residual)):
            d_unscaled[i] = 0.0
            for j in range(len(residual)):
                d_unscaled[i] += closeness * root[j, i] * residual[j]
        for d in range(d_mean.shape[1]):
            d_mean[t, d] = 0.0
            for r in range(len(rows)):
                of_wave = 0.0
                for i in range(len(residual)):
                    of_wave += matrix[i, r] * d_unscaled[i]
                d_mean[t, d] += of_wave * gain[r] * rows[r, d]
    return True
