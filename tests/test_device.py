"""Prediction, its gradient and the fit give the same numbers on a GPU, in float64."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil import ExpectedSaturatingCost, GPDynamics, RBFPolicy, TrajectoryKLLoss
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.particles import sample_trajectories

SPACE = StateSpace(("q", "dq"), ("rad", "rad/s"), (0,), joint_match(("q", "dq"), ("rad", "rad/s")))
DEVICES = [
    "cpu",
    pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")),
]


def results(device: str) -> list[Tensor]:
    """Likelihood of a fit, both losses and those of the mean with their policy gradients, and of
    samples; computed on a device.
    """
    draws = Draws(seed=0)
    states, actions = draws.uniform(-1.5, 1.5, 60, 2), draws.uniform(-2, 2, 60, 1)
    inputs = torch.cat([SPACE.features(states), actions], -1)
    change = 0.1 * torch.stack(
        [inputs[:, 0], inputs[:, 3] - 2 * inputs[:, 1]], -1
    ) + 0.01 * draws.normal(60, 2)
    policy = RBFPolicy(draws.normal(10, 3), torch.tensor([2.0]), torch.ones(3))
    policy.weights.data.copy_(0.5 * draws.normal(10, 1))
    demonstrated = Gaussian(draws.normal(8, 2), draws.cov(8, 2))
    initial = Gaussian(draws.normal(2).to(device), draws.cov(2, scale=0.02).to(device))
    dynamics = GPDynamics(4, 2).to(device)
    likelihood = dynamics.fit(inputs.to(device), change.to(device)).negative_log_likelihood
    kl = TrajectoryKLLoss(policy, dynamics, SPACE, demonstrated, noise_std=0.1).to(device)
    cost = ExpectedSaturatingCost(
        policy, dynamics, SPACE, demonstrated.mean[-1], width=2.0, horizon=8
    ).to(device)
    belief = {"observation_mean": initial.mean, "observation_var": initial.cov}
    values = [likelihood, kl(**belief).detach(), cost(**belief).detach()]
    for per_step in (kl.per_step, kl.mean_per_step, cost.per_step, cost.mean_per_step):
        value = per_step(initial)
        values += [value.detach(), *torch.autograd.grad(value.sum(), list(policy.parameters()))]
    particles = sample_trajectories(
        initial, policy, dynamics, SPACE, 3, 4, torch.Generator().manual_seed(0)
    )
    values += [particles.detach(), *torch.autograd.grad(particles.sum(), list(policy.parameters()))]
    return [value.cpu() for value in values]


@pytest.mark.parametrize("device", DEVICES)
def test_numbers_do_not_depend_on_the_device(device: str) -> None:
    for here, there in zip(results("cpu"), results(device), strict=True):
        torch.testing.assert_close(here, there, rtol=1e-8, atol=1e-8)
