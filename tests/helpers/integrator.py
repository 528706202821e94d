"""A small robot of one entry, learned once for the tests of searches."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.losses import TrajectoryKLLoss

SPACE = StateSpace(("x",), ("m",), (), joint_match(("x",), ("m",)))
U_MAX = torch.tensor([2.0], dtype=torch.float64)


@cache
def damped_integrator() -> GPDynamics:
    """The model of a damped integrator, learned from 30 random transitions."""
    draws = Draws(seed=0)
    x, u = draws.uniform(-1.5, 1.5, 30, 1), draws.uniform(-2, 2, 30, 1)
    dynamics = GPDynamics(2, 1)
    dynamics.fit(torch.cat([x, u], -1), 0.2 * (u - 0.5 * x) + 0.01 * draws.normal(30, 1))
    return dynamics


def random_policy(draws: Draws) -> RBFPolicy:
    """A policy that does little."""
    policy = RBFPolicy(draws.uniform(-1.5, 1.5, 8, 1), U_MAX, torch.ones(1))
    policy.weights.data.copy_(0.1 * draws.normal(8, 1))
    return policy


def belief_at_one(variance: float) -> Gaussian:
    """Of the start, 1 m."""
    return Gaussian(torch.ones(1).double(), torch.full((1, 1), variance, dtype=torch.float64))


def integrator_loss(
    policy: RBFPolicy, mean: Tensor, variance: float, dynamics: GPDynamics | None = None
) -> TrajectoryKLLoss:
    """Demonstrated marginals have that mean (T,) and that variance."""
    cov = torch.full((len(mean), 1, 1), variance, dtype=torch.float64)
    model = dynamics or damped_integrator()
    return TrajectoryKLLoss(policy, model, SPACE, Gaussian(mean[:, None], cov), noise_std=0.05)
