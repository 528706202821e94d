r"""Trajectories of particles that each follow a function of their own.

A particle that draws its next state anew at each step forgets the dynamics that it met earlier at
the same place. Here each particle keeps its function. This works for any policy and any model that
draws functions; moments in closed form are not needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.checks import check_whole
from torch_pmil.control.policy import Act, Policy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, normal
from torch_pmil.model.compiled import kernels
from torch_pmil.model.forward_model import ForwardModel, Functions
from torch_pmil.model.function_samples import FunctionSamples
from torch_pmil.model.particles import ParticlePrediction
from torch_pmil.model.rollout import check_start_belief, compiled_plan


class _Bounded(torch.autograd.Function):
    """States (*batch, D) whose cotangents are clipped to a norm of one in given units (D,)."""

    @staticmethod
    def forward(ctx: Any, states: Tensor, units: Tensor) -> Tensor:
        ctx.save_for_backward(units)
        return states.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (units,) = ctx.saved_tensors
        return gradient / (gradient * units).norm(dim=-1, keepdim=True).clamp(min=1), None


def follow_functions(
    start: Tensor,
    policy: Policy,
    functions: Functions,
    dynamics: ForwardModel,
    space: StateSpace,
    noise: Tensor,
    units: Tensor | None = None,
) -> Tensor:
    r"""States at t = 1..T, (N, \*batch, T, D), of particles that each follow one function.

    Args:
        start: states (N, \*batch, D), of a batch as the policy takes it.
        policy, dynamics, space: as in :func:`~torch_pmil.model.rollout.predict_trajectory`.
        functions: N of those that ``dynamics`` draws.
        noise: added to the outputs of the model, (N, \*batch, T, E).
        units: units of the state, (D,), in which the gradient of each particle is clipped to a norm
            of one at each step. Otherwise a trajectory that tumbles would dominate the others. None
            leaves the gradient exact.
    """
    T, D = noise.shape[-2], start.shape[-1]
    states = start.reshape(len(start), -1, D)
    of_steps = noise.reshape(*states.shape[:2], *noise.shape[-2:])
    units = states.new_zeros(D) if units is None else units
    some = Gaussian(states[0], torch.eye(D).to(states).expand(states.shape[1], D, D))
    plan = compiled_plan(some, policy, dynamics, space, T)
    if plan is None or not isinstance(functions, FunctionSamples):
        parts = policy.controller, functions, dynamics, space
        followed = _followed(states, *parts, of_steps, units)
    else:
        followed = kernels().follow_functions(states, plan, functions, of_steps, units)
    return followed.reshape(*start.shape[:-1], T, D)


def _followed(
    state: Tensor,
    controller: Act,
    functions: Functions,
    dynamics: ForwardModel,
    space: StateSpace,
    noise: Tensor,
    units: Tensor,
) -> Tensor:
    """:func:`follow_functions` of a batch (N, B) by the formulas in PyTorch."""
    states, known = [], dynamics.known_part(space)
    for t in range(noise.shape[-2]):
        features = space.features(state)
        action = controller(features)
        outputs = functions(torch.cat([features, action], -1)) + noise[..., t, :]
        state = _Bounded.apply(known.successors(state, action, outputs), units)
        states.append(state)
    return torch.stack(states, -2)


def sample_consistent_rollouts(
    initial: Gaussian,
    policy: Policy,
    functions: Functions,
    count: int,
    dynamics: ForwardModel,
    space: StateSpace,
    horizon: int,
    generator: torch.Generator,
) -> Tensor:
    """States at t = 0..T, (count, *batch, T + 1, D), of particles from p(x_0) with noise.

    Each follows one of as many functions. Otherwise as
    :func:`~torch_pmil.model.particles.sample_rollouts`.
    """
    check_start_belief(initial, "initial", dynamics, space)
    check_whole("horizon", horizon, 1)
    start = initial.sample(count, generator)
    noise = noise_of_steps(dynamics, (*start.shape[:-1], horizon), generator)
    states = follow_functions(start, policy, functions, dynamics, space, noise)
    return torch.cat([start[..., None, :], states], -2)


def noise_of_steps(
    dynamics: ForwardModel, shape: tuple[int, ...], generator: torch.Generator
) -> Tensor:
    """Draws of the model's noise, (*shape, E)."""
    std = dynamics.noise.sqrt()
    return std * normal((*shape, len(std)), std, generator)


@dataclass(frozen=True)
class SampledPrediction(ParticlePrediction):
    """Prediction for any policy and any model: each particle follows a function of its own.

    Otherwise as :class:`~torch_pmil.model.particles.ParticlePrediction`.

    Example:
        >>> from torch import nn
        >>> from torch_pmil import GPDynamics, ModulePolicy, joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = ModulePolicy(nn.Linear(1, 1), *torch.ones(2, 1), torch.zeros(1))
        >>> dynamics = GPDynamics(2, 1)
        >>> dynamics.set_data(torch.eye(2), torch.zeros(2, 1))
        >>> start = Gaussian(torch.zeros(1).double(), torch.eye(1).double())
        >>> SampledPrediction(count=100)(start, policy, dynamics, space, horizon=5).mean.shape
        torch.Size([5, 1])
    """

    count: int = 500

    def rollouts(
        self,
        initial: Gaussian,
        policy: Policy,
        dynamics: ForwardModel,
        space: StateSpace,
        horizon: int,
    ) -> Tensor:
        """The particles themselves, at t = 0..T, (count, *batch, T + 1, D)."""
        generator = torch.Generator().manual_seed(self.seed)
        functions = dynamics.functions(self.count, generator)
        given = functions, self.count, dynamics, space, horizon, generator
        return sample_consistent_rollouts(initial, policy, *given)
