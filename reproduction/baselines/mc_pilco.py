r"""Policy search by the gradient of particles on a Gaussian process, after MC-PILCO.

A policy's cost is the mean over particles that are drawn from the model step by step, and its
gradient goes through the draws:

.. math:: J = \frac1N \sum_n \sum_{t=1}^T 1 - \exp\left(-\frac{(d^n_t)^2}{2 c}\right), \qquad
    d^n_t = \lVert z(x^n_t) - \mu^{\exp}_t \rVert_{(\Sigma^{\exp}_t)^{-1}}

This is the published saturating cost of a reference, here of the demonstrated marginals in the
match space z.

Written from the published article, as far as we remember its numbers, without its authors' program.
As published are: 400 particles, drawn anew in each step of Adam; a squashed sum of 200 Gaussians
with dropout; the numbers of the descent and when it ends; one Gaussian process for each velocity,
from which the position follows; and that a search goes on from the last policy. Departures:

- At each step a particle's slope is bounded by ``most_slope``, so the gradient is biased. The
  double pendulum is chaotic: otherwise a few particles have slopes of many orders, and their mean
  is noise. ``most_slope`` None is the published gradient, which ``tune_peers`` measures too.
- A search has at most ``most_steps`` steps of Adam, for the time they take; published are more.
- The model is fitted as ours is, its lengthscales and penalties included, and
  its noise is part of each step. How positions follow from velocities is fitted too, in place of
  the trapezoidal rule. Where no entry of the state is another's velocity, all are learned.
- The first policy has centres, widths and weights of a first one of ours: near the demonstrated
  states, and about holding the robot at the start where ours does. Published are uniform draws.
- Weights are in halves of the actions' ranges, centres and widths in first widths: one learning
  rate then suits any robot. A basis function that drops out does so for all actions.

Source: F. Amadio, A. Dalla Libera, R. Antonello, D. Nikovski, R. Carli, D. Romeres (2022),
Model-based policy search using Monte Carlo gradient estimation with real systems application, IEEE
Transactions on Robotics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor

from reproduction.baselines.model_peer import ModelPeer
from reproduction.baselines.monitored_descent import DescentSettings, descend
from reproduction.baselines.particle_posterior import ParticlePosterior
from reproduction.baselines.squashed_network import SquashedNetwork
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.gp.gaussian import normal
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.saturating_cost import saturating_cost
from torch_pmil.tasks.task import Task


class MCPilco(ModelPeer):
    """Particles on our model, and the policy of their least mean distance from the demonstrations.

    Args:
        experiment: what to learn.
        seed: of the first policy, the particles and the dropout.
        scale: c, the squared distance at which a cost saturates, in demonstrated variances.
        most_slope: largest norm of a particle's slope: of its cost from a step on, to its state
            there. None for no limit, as published.
        most_steps: of Adam in each fit.
        particles: their number.
        centres: number of the policy's basis functions.
    """

    label: ClassVar[str] = "particles, as MC-PILCO"
    name: ClassVar[str] = "mc_pilco"
    confirmations: ClassVar[int | None] = 2

    def __init__(
        self,
        experiment: Task,
        seed: int,
        scale: float = 100.0,
        most_slope: float | None = 0.3,
        most_steps: int = 1000,
        particles: int = 400,
        centres: int = 200,
    ) -> None:
        super().__init__(experiment, seed, _speed_model(experiment))
        self.particles, self.most_slope = particles, most_slope
        self.settings, self.costs = DescentSettings(most_steps), list[float]()
        demonstrated = experiment.demonstrated
        L = torch.linalg.cholesky(demonstrated.cov)
        self._target, self._factor = demonstrated.mean, L * math.sqrt(scale)
        first = experiment.with_settings(num_centres=centres).make_policy(self.generator)
        assert isinstance(first, RBFPolicy)  # of a task without parts of a user's own
        basis, actions = first.controller.network, experiment.actions
        widths = math.sqrt(2) * first.scale  # our basis functions are exp(-1/2) at their width
        self.policy = SquashedNetwork(
            basis.inputs.detach(), widths, first.weights.detach().clone(), actions
        )

    def fit(self) -> None:
        """Fit the model to all transitions, and go on with the search of the policy on it."""
        self.fit_model()
        self.costs = descend(self.cost, self.policy.parameters(), self.settings)

    @torch.no_grad()
    def act(self, step: int, states: Tensor) -> Tensor:
        """Actions of the whole policy, of which nothing drops out."""
        limits = self.experiment.actions
        return self.policy(self.experiment.space.features(states)).clamp(limits.low, limits.high)

    def cost(self, dropout: float) -> Tensor:
        """Mean cost of new particles, summed over the steps, with its graph, from 0 to T."""
        offset = self.experiment.space.observe(self.simulate(dropout)) - self._target
        residual = torch.linalg.solve_triangular(self._factor, offset[..., None], upper=False)
        return saturating_cost(residual[..., 0]).sum(-1).mean()

    def simulate(self, dropout: float) -> Tensor:
        """States (N, T, D) of new particles at t = 1..T, under the policy with some of it left out.

        The counterpart for our own policies is
        :func:`~torch_pmil.model.particles.sample_trajectories`.
        """
        space, generator = self.experiment.space, self.generator
        posterior = ParticlePosterior(self.dynamics.expansion)
        noise, known = posterior.expansion.noise, self.dynamics.known_part(space)
        policy = self.policy.controller(dropout, generator)
        state = self.experiment.initial.sample(self.particles, generator)
        shape, states = (self.experiment.horizon, self.particles, len(noise)), []
        for epsilon in normal(shape, state, generator):
            features = space.features(state)
            action = policy(features)
            mean, variance = posterior.predict(torch.cat([features, action], -1))
            outputs = mean + (variance.clamp(min=0) + noise).sqrt() * epsilon
            state = known.successors(state, action, outputs)
            if self.most_slope is not None and state.requires_grad:
                state.register_hook(_bounded(self.most_slope / self.particles))
            states.append(state)
        return torch.stack(states, -2)


def _bounded(most: float) -> Callable[[Tensor], Tensor]:
    """A gradient (N, D) with rows of at most a given norm."""

    def bound(gradient: Tensor) -> Tensor:
        return gradient * (most / gradient.norm(dim=-1, keepdim=True)).clamp(max=1)

    return bound


def _speed_model(experiment: Task) -> GPDynamics:
    """A model of the velocities of a robot, from which its positions follow, if it has any."""
    velocities = bool(rates_of(experiment.space.names))
    dynamics = experiment.with_settings(velocities_alone=velocities).make_dynamics()
    assert isinstance(dynamics, GPDynamics)
    return dynamics
