"""The kernels as functions of PyTorch, with gradients in start beliefs and policies.

Those that may find no answer return None then: the formulas in PyTorch say why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.trigonometry import Augmentation
from torch_pmil.model.compiled.arrays import Functions, NetworkGradient, zeros
from torch_pmil.model.compiled.building import (
    Array,
    Array1,
    Array2,
    Array3,
    compile_all as compile_all,
)
from torch_pmil.model.compiled.costs import (
    CostWork,
    Observation,
    write_costs,
    write_costs_of_means,
)
from torch_pmil.model.compiled.mean_trajectory import (
    MeanTape,
    MeanWork,
    adjoint_of_mean,
    predict_mean,
)
from torch_pmil.model.compiled.plans import Comparison, Plan
from torch_pmil.model.compiled.trajectory import Robot, Steps, StepWork, Tape, predict
from torch_pmil.model.compiled.trajectory_adjoint import Cotangents, adjoint
from torch_pmil.model.compiled.vectors import WIDTH

Parameters = Sequence[Tensor]  # centres, weights and widths of a policy


class _NoAnswer(ArithmeticError):
    """A kernel met a matrix without Cholesky factor, or a number that is not finite."""


def predict_beliefs(start: Gaussian, plan: Plan) -> Gaussian | None:
    """Predicted marginals from N start beliefs.

    Args:
        start: mean (N, D) and covariance (N, D, D).
        plan: what is predicted, and with which policy.

    Returns:
        Mean (N, T, D) and covariance (N, T, D, D), or None where a belief has no answer.
    """
    try:
        parameters = plan.controller.parameters
        return Gaussian(*_Beliefs.apply(plan, start.mean, symmetric(start.cov), *parameters))
    except _NoAnswer:
        return None


def predict_states(start: Tensor, plan: Plan) -> Tensor:
    """States of the model's mean alone, (N, T, D), from N states (N, D); some may not be finite."""
    return _States.apply(plan, start, *plan.controller.parameters)


class _Beliefs(torch.autograd.Function):
    """:func:`predict_beliefs`: tapes of the prediction, and one adjoint sweep over each."""

    @staticmethod
    def forward(
        ctx: Any, plan: Plan, mean: Tensor, cov: Tensor, *parameters: Tensor
    ) -> tuple[Tensor, Tensor]:
        (N, D), T, keep = mean.shape, plan.horizon, any(ctx.needs_input_grad)
        robots = _robots(plan, parameters, N)
        tapes: list[Tape | None] = [None] * N
        start = _array(mean), _array(cov)  # here: other threads record graphs of their own
        means, covs = np.empty((N, T, D)), np.empty((N, T, D, D))

        def roll_out(i: int) -> None:
            tape = Tape.of(robots[i], T)
            tape.mean[0], tape.cov[0] = (part[i] for part in start)
            if predict(robots[i], tape, StepWork.of(robots[i])):
                raise _NoAnswer
            means[i], covs[i] = tape.mean[1:], tape.cov[1:]
            tapes[i] = tape if keep else None

        _each(roll_out, N)
        ctx.robots, ctx.tapes = robots, tapes
        ctx.save_for_backward(*parameters)
        if not (np.isfinite(means).all() and np.isfinite(covs).all()):
            raise _NoAnswer
        return torch.from_numpy(means), torch.from_numpy(covs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_mean: Tensor, d_cov: Tensor) -> tuple[Tensor | None, ...]:
        N, _, D = d_mean.shape
        d_means, d_covs = _array(d_mean), _array(symmetric(d_cov))
        of_mean, of_cov = np.empty((N, D)), np.empty((N, D, D))
        gradients = [NetworkGradient.zero(robot.network) for robot in ctx.robots]

        def roll_back(i: int) -> None:
            robot, tape = ctx.robots[i], ctx.tapes[i]
            work, out = (StepWork.of(robot), Cotangents.of(robot)), (of_mean[i], of_cov[i])
            adjoint(robot, tape, d_means[i], d_covs[i], *work, *out, gradients[i])

        _each(roll_back, N)
        of_start = torch.from_numpy(of_mean), torch.from_numpy(of_cov)
        return None, *of_start, *_gradients(gradients, ctx.saved_tensors)


class _States(torch.autograd.Function):
    """:func:`predict_states`, as :class:`_Beliefs`."""

    @staticmethod
    def forward(ctx: Any, plan: Plan, start: Tensor, *parameters: Tensor) -> Tensor:
        robots = _robots(plan, parameters, len(start))
        tapes = [MeanTape.of(robot, plan.horizon) for robot in robots]
        for i, (robot, tape) in enumerate(zip(robots, tapes, strict=True)):
            tape.states[0] = start[i].numpy()
            predict_mean(robot, tape, MeanWork.of(robot.model), MeanWork.of(robot.network))
        ctx.robots, ctx.tapes = robots, tapes
        ctx.save_for_backward(*parameters)
        states = np.stack([tape.states[1:] for tape in tapes])
        return torch.from_numpy(states)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        d_states, d_start = _array(gradient), np.empty((len(gradient), gradient.shape[-1]))
        gradients = [NetworkGradient.zero(robot.network) for robot in ctx.robots]
        for i, (robot, tape) in enumerate(zip(ctx.robots, ctx.tapes, strict=True)):
            works = MeanWork.of(robot.model), MeanWork.of(robot.network)
            d_inputs = np.empty(len(robot.model.inputs))
            adjoint_of_mean(robot, tape, d_states[i], *works, d_inputs, d_start[i], gradients[i])
        return None, torch.from_numpy(d_start), *_gradients(gradients, ctx.saved_tensors)


def costs_of_beliefs(states: Gaussian, comparison: Comparison) -> Tensor | None:
    r"""Costs of predicted marginals, (\*batch, T); None where a covariance is none."""
    try:
        return _Costs.apply(comparison, states.mean, states.cov)
    except _NoAnswer:
        return None


def costs_of_states(states: Tensor, comparison: Comparison) -> Tensor | None:
    r"""Costs of states without variance, (\*batch, T).

    They are :math:`\tfrac12 r^\top \hat\Sigma^{-1} r` with the demonstrated covariance, or the
    saturating cost; None where that covariance has no Cholesky factor.
    """
    try:
        return _CostsOfMeans.apply(comparison, states)
    except _NoAnswer:
        return None


class _Costs(torch.autograd.Function):
    """:func:`costs_of_beliefs`; the gradients are computed along with the costs."""

    @staticmethod
    def forward(ctx: Any, comparison: Comparison, mean: Tensor, cov: Tensor) -> Tensor:
        batch, D = mean.shape[:-1], mean.shape[-1]
        observation = _observation(comparison, batch)
        demonstrated, half_log_det = _determinants(comparison, batch)
        means, covs = _array(mean.reshape(-1, D)), _array(cov.reshape(-1, D, D))
        costs, d_mean, d_cov = np.empty(len(means)), np.empty_like(means), np.empty_like(covs)
        work, out = CostWork.of(observation), (costs, d_mean, d_cov)
        failed = write_costs(observation, demonstrated, half_log_det, means, covs, work, *out)
        if failed or not np.isfinite(costs).all():
            raise _NoAnswer
        ctx.save_for_backward(
            *(torch.from_numpy(t).reshape_as(s) for t, s in ((d_mean, mean), (d_cov, cov)))
        )
        return torch.from_numpy(costs).reshape(batch)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        d_mean, d_cov = ctx.saved_tensors
        return None, gradient[..., None] * d_mean, gradient[..., None, None] * d_cov


class _CostsOfMeans(torch.autograd.Function):
    """:func:`costs_of_states`, as :class:`_Costs`."""

    @staticmethod
    def forward(ctx: Any, comparison: Comparison, mean: Tensor) -> Tensor:
        batch, D = mean.shape[:-1], mean.shape[-1]
        observation = _observation(comparison, batch)
        means = _array(mean.reshape(-1, D))
        costs, d_mean = np.empty(len(means)), np.empty_like(means)
        saturating = comparison.demonstrated is None
        work = CostWork.of(observation)
        write_costs_of_means(
            observation, _roots(comparison, batch), means, saturating, work, costs, d_mean
        )
        ctx.save_for_backward(torch.from_numpy(d_mean).reshape_as(mean))
        return torch.from_numpy(costs).reshape(batch)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        (d_mean,) = ctx.saved_tensors
        return None, gradient[..., None] * d_mean


def _robots(plan: Plan, parameters: Parameters, beliefs: int) -> list[Robot]:
    """What the kernels predict with, one for each belief."""
    centres, weights, widths = (parameter.detach() for parameter in parameters)
    f, controller = plan.model, plan.controller
    variance = f.observed_prior_cov if plan.observation_noise else f.prior_cov
    model = _functions(f)._replace(variance=_array(variance.diagonal()))
    rows, turns, kept = _combinations(plan.space.augmentation)
    networks = [
        KernelExpansion(centres, own, widths, controller.network.signal_variance)
        for own in (weights if weights.ndim == 3 else [weights])
    ]
    packed = [_packed(network, controller.network.offset) for network in networks]
    limits, steps = _array(controller.u_max), Steps.compile()
    return [
        Robot(model, network, limits, rows, turns, kept, plan.differences, steps)
        for network in (packed if len(packed) > 1 else packed * beliefs)
    ]


def _observation(comparison: Comparison, batch: tuple[int, ...]) -> Observation:
    """The map for states (*batch, D) in one row."""
    offset = comparison.offset.expand(*batch, -1).flatten(0, -2)
    combinations = _combinations(comparison.augmentation)
    return Observation(*combinations, *map(_array, (comparison.matrix, offset, comparison.noise)))


def _determinants(comparison: Comparison, batch: tuple[int, ...]) -> tuple[Array3, Array1]:
    """Demonstrated covariances, and half the logarithms of their determinants; empty if none."""
    if comparison.demonstrated is None:
        return np.empty((0, 0, 0)), np.empty(0)
    factor = _factor(comparison.demonstrated)
    half_log_det = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    flat = comparison.demonstrated.expand(*batch, -1, -1).flatten(0, -3)
    return _array(flat), _array(half_log_det.expand(batch).flatten())


def _factor(cov: Tensor) -> Tensor:
    """Cholesky factors, or no answer."""
    factor, failed = torch.linalg.cholesky_ex(cov)
    if failed.any():
        raise _NoAnswer
    return factor


def _roots(comparison: Comparison, batch: tuple[int, ...]) -> Array3:
    """Matrices G with G' G the inverse of the demonstrated covariances; else the identity."""
    M = comparison.offset.shape[-1]
    if comparison.demonstrated is None:
        return np.eye(M)[None]
    factor = _factor(comparison.demonstrated)
    identity = torch.eye(M).to(factor)
    root = torch.linalg.solve_triangular(factor, identity, upper=False)
    return _array(root.expand(*batch, -1, -1).flatten(0, -3))


_packs: WeakKeyDictionary[KernelExpansion, Functions] = WeakKeyDictionary()


def _functions(f: KernelExpansion) -> Functions:
    """A GP's posterior as the kernels read it, kept as long as it."""
    if f not in _packs:
        _packs[f] = _packed(f, f.offset)
    return _packs[f]


def _packed(f: KernelExpansion, offset: Tensor | float) -> Functions:
    """Functions with data of weight zero, up to a multiple of a vector's width."""
    (n, D), E = f.inputs.shape, f.num_outputs
    padded = n + -n % WIDTH
    inputs, weights = zeros(D, padded), zeros(E, padded)
    inputs[:, :n], weights[:, :n] = _array(f.inputs.mT), _array(f.weights)
    log_signal, squares = _array(f.log_signal_variance), _array(f.lengthscales.square())
    offsets = np.array(np.broadcast_to(np.asarray(offset, dtype=float), E))
    own = _own_weights(f.weights, f.gram_inverse, padded)
    return Functions(inputs, weights, squares, log_signal, offsets, np.zeros(E), own)


def _own_weights(weights: Tensor, gram_inverse: Tensor | None, padded: int) -> Array3:
    """Weights of pairs of data in a GP's variances, as in :class:`Functions`."""
    if gram_inverse is None:
        return np.zeros((0, 0, 0))
    E, n = weights.shape
    own = zeros(E, padded, padded)
    inverses = gram_inverse.detach().numpy()
    for out, beta, inverse in zip(own, _array(weights), inverses, strict=True):
        for i in range(n):  # row by row: no other matrix of that size is needed
            out[i, i:n] = beta[i] * beta[i:] - inverse[i, i:]
            out[i, i] /= 2
    return own


def _combinations(augmentation: Augmentation) -> tuple[Array2, Array1, int]:
    """Rows, turns and number of the kept ones of the combinations of the state."""
    return _array(augmentation.rows), _array(augmentation.turns), augmentation.kept


def _gradients(gradients: list[NetworkGradient], parameters: Parameters) -> list[Tensor]:
    """Gradients in centres (m, D'), weights (F, m) or (N, F, m), and widths (F, D')."""
    centres, weights, widths = parameters
    m = len(centres)
    of_weights = np.stack([gradient.weights[:, :m] for gradient in gradients])
    of_inputs = np.sum([gradient.inputs[:, :m] for gradient in gradients], 0).T
    of_squares = np.sum([gradient.squares for gradient in gradients], 0)
    return [
        torch.from_numpy(of_inputs),
        torch.from_numpy(of_weights if weights.ndim == 3 else of_weights.sum(0)),
        2 * widths.detach() * torch.from_numpy(of_squares),
    ]


def _array(values: Tensor) -> Array:
    """The values of a tensor as kernels take them, C-contiguous."""
    return np.ascontiguousarray(values.detach().numpy(), dtype=np.float64)


def _each(function: Callable[[int], None], count: int) -> None:
    """Call a function for every belief, in as many threads as PyTorch may use."""
    if count == 1 or torch.get_num_threads() == 1:
        for i in range(count):
            function(i)
    else:
        list(_threads(torch.get_num_threads()).map(function, range(count)))


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, "prediction")
