"""The kernels as PyTorch functions; where they return None, the formulas find out why."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import prod
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, symmetric
from torch_pmil.model.compiled.arrays import NetworkGradient, filled_up, zeros
from torch_pmil.model.compiled.building import compile_all as compile_all
from torch_pmil.model.compiled.costs import CostWork, write_costs, write_costs_of_means
from torch_pmil.model.compiled.objective import PolicyObjective as PolicyObjective
from torch_pmil.model.compiled.packing import (
    array,
    determinants_of,
    draws_of,
    gradients_of,
    mean_of,
    observation_of,
    packed_draws,
    robots_of,
    roots_of,
)
from torch_pmil.model.compiled.plans import Comparison, Drawn, Plan
from torch_pmil.model.compiled.sampled_functions import write_outputs
from torch_pmil.model.compiled.sampled_trajectory import (
    ParticleTape,
    ParticleWork,
    follow,
    roll_back,
)
from torch_pmil.model.compiled.trajectory import StepWork, Tape, predict
from torch_pmil.model.compiled.trajectory_adjoint import Cotangents, adjoint


class _NoAnswer(ArithmeticError):
    """A kernel met a matrix without Cholesky factor, or a number that is not finite."""


def predict_beliefs(start: Gaussian, plan: Plan) -> Gaussian | None:
    """Predicted marginals, mean (N, T, D), from N beliefs, or None where one has no answer."""
    try:
        parameters = plan.controller.parameters
        return Gaussian(*_Beliefs.apply(plan, start.mean, symmetric(start.cov), *parameters))
    except _NoAnswer:
        return None


def predict_states(start: Tensor, plan: Plan) -> Tensor:
    """States of the model's mean alone, (N, T, D), from N states (N, D); some may not be finite."""
    noise = start.new_zeros(1, len(start), plan.horizon, plan.model.num_outputs)
    given = plan, None, noise, start.new_zeros(start.shape[-1]), start[None]
    return _States.apply(*given, *plan.controller.parameters)[0]


def follow_functions(
    start: Tensor, plan: Plan, drawn: Drawn, noise: Tensor, units: Tensor
) -> Tensor:
    """States (N, B, T, D) of particles from starts (N, B, D) that follow drawn functions."""
    return _States.apply(plan, drawn, noise, units, start, *plan.controller.parameters)


def outputs_of(drawn: Drawn, inputs: Tensor) -> Tensor:
    r"""Outputs (N, \*batch, E) of drawn functions at inputs (N, \*batch, D' + F) of their own."""
    return _Outputs.apply(drawn, inputs)


class _Beliefs(torch.autograd.Function):
    """:func:`predict_beliefs`: tapes of the prediction, and one adjoint sweep over each."""

    @staticmethod
    def forward(
        ctx: Any, plan: Plan, mean: Tensor, cov: Tensor, *parameters: Tensor
    ) -> tuple[Tensor, Tensor]:
        (N, D), T, keep = mean.shape, plan.horizon, any(ctx.needs_input_grad)
        robots = robots_of(plan, parameters, N)
        tapes: list[Tape | None] = [None] * N
        start = array(mean), array(cov)  # here: other threads record graphs of their own
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
        d_means, d_covs = array(d_mean), array(symmetric(d_cov))
        of_mean, of_cov = np.empty((N, D)), np.empty((N, D, D))
        gradients = [NetworkGradient.zero(robot.network) for robot in ctx.robots]

        def roll_back(i: int) -> None:
            robot, tape = ctx.robots[i], ctx.tapes[i]
            work, out = (StepWork.of(robot), Cotangents.of(robot)), (of_mean[i], of_cov[i])
            adjoint(robot, tape, d_means[i], d_covs[i], *work, *out, gradients[i])

        _each(roll_back, N)
        of_start = torch.from_numpy(of_mean), torch.from_numpy(of_cov)
        return None, *of_start, *gradients_of(gradients, ctx.saved_tensors)


class _States(torch.autograd.Function):
    """States (N, B, T, D) of N particles from B starts each, as :class:`_Beliefs`.

    Functions are drawn, or the mean of the plan's model; noise is (N, B, T, E).
    """

    @staticmethod
    def forward(
        ctx: Any,
        plan: Plan,
        drawn: Drawn | None,
        noise: Tensor,
        units: Tensor,
        start: Tensor,
        *parameters: Tensor,
    ) -> Tensor:
        (N, B), T = start.shape[:2], plan.horizon
        robots = robots_of(plan, parameters, B, moments=False)
        model, middle = robots[0].model, plan.controller.u_middle
        draws = mean_of(model) if drawn is None else draws_of(model, drawn, middle)
        tapes = [ParticleTape.of(robot, N, T) for robot in robots]
        starts, noises = array(start.transpose(0, 1)), array(noise.transpose(0, 1))
        work = ParticleWork.of(robots[0], draws)
        for robot, tape, of_start, of_noise in zip(robots, tapes, starts, noises, strict=True):
            tape.states[:, 0] = of_start
            follow(robot, draws, of_noise, tape, work)
        ctx.robots, ctx.tapes, ctx.units, ctx.work = robots, tapes, array(units), work
        ctx.save_for_backward(*parameters)
        return torch.from_numpy(np.stack([tape.states[:, 1:] for tape in tapes], 1))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        (N, B, _, D), d_states = gradient.shape, array(gradient.transpose(0, 1))
        d_start = np.empty((B, N, D))
        gradients = [NetworkGradient.zero(robot.network) for robot in ctx.robots]
        for i, (robot, tape) in enumerate(zip(ctx.robots, ctx.tapes, strict=True)):
            sweep = tape, d_states[i], ctx.units, ctx.work
            roll_back(robot, *sweep, d_start[i], gradients[i])
        of_start = torch.from_numpy(d_start).transpose(0, 1)
        of_parameters = gradients_of(gradients, ctx.saved_tensors)
        return None, None, None, None, of_start, *of_parameters


class _Outputs(torch.autograd.Function):
    """:func:`outputs_of`; the slopes are computed along with the outputs."""

    @staticmethod
    def forward(ctx: Any, drawn: Drawn, inputs: Tensor) -> Tensor:
        draws, (N, *batch, D) = packed_draws(drawn), inputs.shape
        E, B = len(draws.offset), prod(batch)
        points, scratch = array(inputs).reshape(N, B, D), (zeros(D), zeros(draws.most_terms))
        outputs, slopes = np.empty((N, B, E)), np.empty((N, B, E, filled_up(D)))
        write_outputs(draws, points, *scratch, outputs, slopes)
        of_inputs = torch.from_numpy(slopes[..., :D])
        ctx.save_for_backward(of_inputs.reshape(N, *batch, E, D))
        return torch.from_numpy(outputs).reshape(N, *batch, E)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor]:
        (slopes,) = ctx.saved_tensors
        return None, (gradient[..., None, :] @ slopes)[..., 0, :]


def costs_of_beliefs(states: Gaussian, comparison: Comparison) -> Tensor | None:
    r"""Costs of predicted marginals, (\*batch, T); None where a covariance is not valid."""
    try:
        return _Costs.apply(comparison, states.mean, states.cov)
    except (_NoAnswer, NotPositiveDefiniteError):
        return None


def costs_of_states(states: Tensor, comparison: Comparison) -> Tensor | None:
    r"""Costs of states without variance, (\*batch, T).

    They are :math:`\tfrac12 r^\top \hat\Sigma^{-1} r` with the demonstrated covariance (None if it
    has no Cholesky factor), or the saturating cost.
    """
    try:
        return _CostsOfMeans.apply(comparison, states)
    except NotPositiveDefiniteError:
        return None


class _Costs(torch.autograd.Function):
    """:func:`costs_of_beliefs`; the gradients are computed along with the costs."""

    @staticmethod
    def forward(ctx: Any, comparison: Comparison, mean: Tensor, cov: Tensor) -> Tensor:
        batch, D = mean.shape[:-1], mean.shape[-1]
        observation = observation_of(comparison, batch)
        demonstrated = *determinants_of(comparison, batch), comparison.cross_entropy
        means, covs = array(mean.reshape(-1, D)), array(cov.reshape(-1, D, D))
        costs, d_mean, d_cov = np.empty(len(means)), np.empty_like(means), np.empty_like(covs)
        work, out = CostWork.of(observation), (costs, d_mean, d_cov)
        failed = write_costs(observation, *demonstrated, means, covs, work, *out)
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
        observation = observation_of(comparison, batch)
        means = array(mean.reshape(-1, D))
        costs, d_mean = np.empty(len(means)), np.empty_like(means)
        saturating = comparison.demonstrated is None
        roots, work = roots_of(comparison, batch), CostWork.of(observation)
        write_costs_of_means(observation, roots, means, saturating, work, costs, d_mean)
        ctx.save_for_backward(torch.from_numpy(d_mean).reshape_as(mean))
        return torch.from_numpy(costs).reshape(batch)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        (d_mean,) = ctx.saved_tensors
        return None, gradient[..., None] * d_mean


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
