r"""Functions drawn from a posterior, and trajectories of which each follows one of them.

A particle that draws its next state anew at each step forgets what the dynamics were where it was
before. Here each particle keeps its function. It is drawn by pathwise conditioning (Wilson et al.
2020): a function of the prior, from random Fourier features, and the exact update that the data
make to it. A particle then costs O(n) a step, not O(n²).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.checks import check_whole
from torch_pmil.control.rbf_policy import Controller, Policy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, normal, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.kernel_pairs import gram
from torch_pmil.model.compiled import kernels
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.rollout import check_start_belief, compiled_plan

FREQUENCIES = 100  # the prior's covariances are then off by a tenth of its variance


@dataclass(frozen=True, eq=False)
class FunctionSamples:
    r"""N functions of E outputs, drawn from the posterior of an expansion with data.

    .. math::
        f_a(x) = c_a + \phi_a(x)^\top w_a + \sum_i v_{ai} k_a(x, x_i), \qquad
        v_a = \beta_a - G_a (\Phi_a w_a + \epsilon_a)

    The features :math:`\phi_a` are cosines and sines of J frequencies
    :math:`\omega \sim \mathcal N(0, \Lambda_a^{-1})`, which all samples share, with weights
    :math:`w \sim \mathcal N(0, \alpha_a^2 / J)`. With the inverse Gram matrix G and
    :math:`\operatorname{cov}(G \epsilon) = G - G K G`, the samples have the posterior's mean, and
    its covariance but for the features. For an exact posterior :math:`\epsilon` is the noise of the
    data; for a sparse one it is what the inducing values leave open.

    Args:
        expansion: the posterior, with weights beta and Gram matrix.
        frequencies: (E, J, D), in one over the units of the inputs.
        weights: of all cosines, then of all sines, (N, E, 2 J).
        updates: v, (N, E, n).

    Example:
        >>> x = torch.linspace(-2, 2, 20, dtype=torch.float64)[:, None]
        >>> model = GPDynamics(num_inputs=1, num_outputs=1)
        >>> _ = model.fit(x, x.sin())
        >>> functions = FunctionSamples.draw(model, 50, torch.Generator().manual_seed(0))
        >>> at_zero = functions(torch.zeros(50, 1, dtype=torch.float64))
        >>> at_zero.shape, bool(at_zero.mean().abs() < 1e-2)
        (torch.Size([50, 1]), True)
    """

    expansion: KernelExpansion
    frequencies: Tensor
    weights: Tensor
    updates: Tensor

    @classmethod
    @torch.no_grad()
    def draw(cls, dynamics: GPDynamics, count: int, generator: torch.Generator) -> FunctionSamples:
        """Draw functions from the posterior of a model.

        Raises ValueError if the count is less than one, RuntimeError if the model has no data.
        """
        check_whole("count", count, 1)
        expansion = dynamics.expansion
        inputs, inverse, E = expansion.inputs, expansion.gram_inverse, expansion.num_outputs
        assert inverse is not None  # it is the posterior of a GP
        shape = E, FREQUENCIES, expansion.num_inputs
        frequencies = normal(shape, inputs, generator) / expansion.lengthscales[:, None]
        scale = (expansion.signal_variance / FREQUENCIES).sqrt()
        weights = scale[:, None] * normal((count, E, 2 * FREQUENCIES), inputs, generator)
        prior = weights.transpose(0, 1) @ _features(frequencies, inputs).mT  # (E, N, n)
        white = normal(prior.shape, inputs, generator)
        root = _root_of_sparse(expansion) if dynamics.sparse else _root_of_exact(expansion)
        changes = prior @ inverse + white @ root
        updates = (expansion.weights[:, None] - changes).transpose(0, 1).contiguous()
        return cls(expansion, frequencies, weights, updates)

    def __len__(self) -> int:
        return len(self.weights)

    def __call__(self, inputs: Tensor) -> Tensor:
        r"""Outputs (N, \*batch, E) of each function at inputs (N, \*batch, D) of its own."""
        features = _features(self.frequencies, inputs[..., None, None, :])[..., 0, :]
        of_prior = torch.einsum("n...ej,nej->n...e", features, self.weights)
        of_data = torch.einsum("n...ei,nei->n...e", self.expansion.kernel(inputs), self.updates)
        return of_prior + of_data + self.expansion.offset


def _features(frequencies: Tensor, inputs: Tensor) -> Tensor:
    r"""Cosines and sines (\*batch, E, n, 2 J) at inputs (\*batch, 1, n, D) or (n, D)."""
    phases = inputs @ frequencies.mT
    return torch.cat([phases.cos(), phases.sin()], -1)


def _root_of_exact(expansion: KernelExpansion) -> Tensor:
    r"""R (E, n, n) with :math:`R^\top R = G - G K G`, which is the noise times G²."""
    assert expansion.gram_inverse is not None
    return expansion.noise.sqrt()[:, None, None] * expansion.gram_inverse


def _root_of_sparse(expansion: KernelExpansion) -> Tensor:
    """The same where the data are inducing inputs."""
    inverse, inputs = expansion.gram_inverse, expansion.inputs
    assert inverse is not None
    between = gram(inputs, inputs, expansion.lengthscales, expansion.signal_variance)
    values, vectors = torch.linalg.eigh(symmetric(inverse - inverse @ between @ inverse))
    return values.clamp(min=0).sqrt()[..., None] * vectors.mT


class _Bounded(torch.autograd.Function):
    """States (*batch, D), whose cotangents are shortened to a norm of one in given units (D,)."""

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
    functions: FunctionSamples,
    dynamics: GPDynamics,
    space: StateSpace,
    noise: Tensor,
    units: Tensor | None = None,
) -> Tensor:
    r"""States at t = 1..T, (N, \*batch, T, D), of particles that each follow one function.

    Args:
        start: states (N, \*batch, D), of a batch as the policy takes it.
        policy, dynamics, space: as in :func:`~torch_pmil.model.rollout.predict_trajectory`.
        functions: N samples of the posterior of ``dynamics``.
        noise: added to the outputs of the model, (N, \*batch, T, E).
        units: bound of the gradient, (D,): before each step it is shortened for each particle to
            the norm one when the state is in these units. A trajectory that tumbles would otherwise
            drown the others. None leaves it exact.
    """
    T, D = noise.shape[-2], start.shape[-1]
    states = start.reshape(len(start), -1, D)
    of_steps = noise.reshape(*states.shape[:2], *noise.shape[-2:])
    units = states.new_zeros(D) if units is None else units
    some = Gaussian(states[0], torch.eye(D).to(states).expand(states.shape[1], D, D))
    plan = compiled_plan(some, policy, dynamics, space, T)
    if plan is None:
        parts = policy.controller, functions, dynamics, space
        followed = _followed(states, *parts, of_steps, units)
    else:
        followed = kernels().follow_functions(states, plan, functions, of_steps, units)
    return followed.reshape(*start.shape[:-1], T, D)


def _followed(
    state: Tensor,
    controller: Controller,
    functions: FunctionSamples,
    dynamics: GPDynamics,
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
    functions: FunctionSamples,
    dynamics: GPDynamics,
    space: StateSpace,
    horizon: int,
    generator: torch.Generator,
) -> Tensor:
    """States at t = 0..T, (N, *batch, T + 1, D), of particles from p(x_0) with the model's noise.

    Each follows its function. Otherwise as :func:`~torch_pmil.model.particles.sample_rollouts`.
    """
    check_start_belief(initial, "initial", dynamics, space)
    check_whole("horizon", horizon, 1)
    start = initial.sample(len(functions), generator)
    noise = noise_of_steps(dynamics, (*start.shape[:-1], horizon), generator)
    states = follow_functions(start, policy, functions, dynamics, space, noise)
    return torch.cat([start[..., None, :], states], -2)


def noise_of_steps(
    dynamics: GPDynamics, shape: tuple[int, ...], generator: torch.Generator
) -> Tensor:
    """Draws of the model's noise, (*shape, E)."""
    std = dynamics.expansion.noise.sqrt()
    return std * normal((*shape, len(std)), std, generator)
