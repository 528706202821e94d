"""Prediction, its gradient, fit and search give the same numbers on a GPU, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil import ExpectedSaturatingCost, GPDynamics, RBFPolicy, TrajectoryKLLoss
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.particles import sample_trajectories
from torch_pmil.model.sampled_rollouts import sample_consistent_rollouts
from torch_pmil.search.sample_search import search_on_samples

SPACE = StateSpace(("q", "dq"), ("rad", "rad/s"), (0,), joint_match(("q", "dq"), ("rad", "rad/s")))
DEVICES = [
    "cpu",
    pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")),
]


@dataclass(frozen=True)
class Parts:
    """What a prediction needs, on a device.

    Args:
        inputs, changes: data of the model, (60, 4) and (60, 2), on the CPU.
    """

    inputs: Tensor
    changes: Tensor
    policy: RBFPolicy
    dynamics: GPDynamics
    demonstrated: Gaussian
    initial: Gaussian

    @classmethod
    def on(cls, device: str) -> Parts:
        """The same numbers on each device."""
        draws = Draws(seed=0)
        states, actions = draws.uniform(-1.5, 1.5, 60, 2), draws.uniform(-2, 2, 60, 1)
        inputs = torch.cat([SPACE.features(states), actions], -1)
        changes = 0.1 * torch.stack(
            [inputs[:, 0], inputs[:, 3] - 2 * inputs[:, 1]], -1
        ) + 0.01 * draws.normal(60, 2)
        policy = RBFPolicy(draws.normal(10, 3), torch.tensor([2.0]), torch.ones(3))
        policy.weights.data.copy_(0.5 * draws.normal(10, 1))
        demonstrated = Gaussian(draws.normal(8, 2), draws.cov(8, 2))
        initial = Gaussian(draws.normal(2).to(device), draws.cov(2, scale=0.02).to(device))
        # fitted on the CPU: an optimum is flat, so that its place differs by more than its value
        dynamics = GPDynamics(4, 2)
        dynamics.fit(inputs, changes)
        dynamics.to(device)
        return cls(inputs, changes, policy.to(device), dynamics, demonstrated, initial)

    def kl(self) -> TrajectoryKLLoss:
        """The objective of an imitation."""
        parts = self.policy, self.dynamics, SPACE, self.demonstrated
        return TrajectoryKLLoss(*parts, noise_std=0.1).to(self.initial.mean.device)


def results(device: str) -> list[Tensor]:
    """Likelihood of a fit, both losses and those of the mean with their policy gradients, and of
    samples, drawn at each step and of functions; computed on a device.
    """
    parts = Parts.on(device)
    policy, dynamics, initial = parts.policy, parts.dynamics, parts.initial
    fit = GPDynamics(4, 2).to(device).fit(parts.inputs.to(device), parts.changes.to(device))
    kl = parts.kl()
    cost = ExpectedSaturatingCost(
        policy, dynamics, SPACE, parts.demonstrated.mean[-1], width=2.0, horizon=8
    ).to(device)
    belief = {"observation_mean": initial.mean, "observation_var": initial.cov}
    values = [fit.negative_log_likelihood, kl(**belief).detach(), cost(**belief).detach()]
    for per_step in (kl.per_step, kl.mean_per_step, cost.per_step, cost.mean_per_step):
        value = per_step(initial)
        values += [value.detach(), *torch.autograd.grad(value.sum(), list(policy.parameters()))]
    particles = sample_trajectories(
        initial, policy, dynamics, SPACE, 3, 4, torch.Generator().manual_seed(0)
    )
    values += [particles.detach(), *torch.autograd.grad(particles.sum(), list(policy.parameters()))]
    functions = dynamics.functions(6, torch.Generator().manual_seed(1))
    given = 6, dynamics, SPACE, 4, torch.Generator().manual_seed(2)
    followed = sample_consistent_rollouts(initial, policy, functions, *given)
    values += [followed.detach(), *torch.autograd.grad(followed.sum(), list(policy.parameters()))]
    return [value.cpu() for value in values]


@pytest.mark.parametrize("device", DEVICES)
def test_numbers_do_not_depend_on_the_device(device: str) -> None:
    for here, there in zip(results("cpu"), results(device), strict=True):
        torch.testing.assert_close(here, there, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("device", DEVICES)
def test_search_on_samples_takes_the_same_steps_on_each_device(device: str) -> None:
    policies = []
    for parts in (Parts.on("cpu"), Parts.on(device)):
        generator = torch.Generator().manual_seed(0)
        search_on_samples(parts.kl(), parts.initial, steps=5, generator=generator)
        policies.append(parts.policy.cpu().state_dict())
    for name, here in policies[0].items():
        torch.testing.assert_close(here, policies[1][name], rtol=1e-7, atol=1e-7)
