"""Losses that tests share: a pendulum that shows its tip, with a random policy and aim."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.target_losses import ExpectedSaturatingCost

HORIZON, NOISE_STD, WIDTH = 4, 0.1, 0.4
TIP = MatchSpace(
    ("x", "y"),
    ("m", "m"),
    torch.tensor([[1.0, 0.0]]),
    torch.tensor([[0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 0.5]]),
)
SPACE = StateSpace(("q", "dq"), ("rad", "rad/s"), (0,), TIP)


def make_parts(draws: Draws) -> tuple[RBFPolicy, GPDynamics]:
    features = SPACE.features(draws.uniform(-1.5, 1.5, 25, 2))
    inputs = torch.cat([features, draws.uniform(-2, 2, 25, 1)], -1)
    targets = 0.1 * torch.stack([inputs[:, 0], inputs[:, 3] - 2 * inputs[:, 1]], -1)
    dynamics = GPDynamics(4, 2)
    dynamics.set_data(inputs, targets)
    lengthscales = torch.tensor([[[3.0, 1.5, 1.5, 4.0]], [[2.5, 1.8, 1.2, 5.0]]])
    dynamics.gp.covar_module.base_kernel.lengthscale = lengthscales
    dynamics.gp.likelihood.noise = torch.full((2, 1), 1e-3)
    policy = RBFPolicy(draws.normal(5, 3), torch.tensor([2.0]), torch.ones(3))
    policy.weights.data.copy_(0.5 * draws.normal(5, 1))
    return policy, dynamics


def make_kl(seed: int, **kwargs) -> TrajectoryKLLoss:
    draws = Draws(seed)
    parts, demonstrated = make_parts(draws), draws.belief(HORIZON, 2, scale=0.05)
    return TrajectoryKLLoss(*parts, SPACE, demonstrated, NOISE_STD, **kwargs)


def make_cost(seed: int, **kwargs) -> ExpectedSaturatingCost:
    draws = Draws(seed)
    parts = make_parts(draws)
    aim = {
        "target": TIP(draws.normal(2)),
        "width": WIDTH,
        "horizon": HORIZON,
        "weight": draws.cov(2, scale=1.0),
    }
    return ExpectedSaturatingCost(*parts, SPACE, **(aim | kwargs))


def start_belief(draws: Draws, *batch: int) -> Gaussian:
    """Beliefs of the pendulum's start."""
    return Gaussian(0.5 * draws.normal(*batch, 2), draws.cov(*batch, 2, scale=0.02))


def assert_gradient_is_the_difference_quotient(
    per_step: Callable[[Gaussian], Tensor], initial: Gaussian, parameter: Tensor, direction: Tensor
) -> None:
    """Of the sum of a loss's steps, in that direction of a parameter."""
    (gradient,) = torch.autograd.grad(per_step(initial).sum(), parameter)
    step, values = 1e-4, []
    for move in (step, -2 * step):
        parameter.data.add_(direction, alpha=move)
        values.append(per_step(initial).sum().item())
    slope = (gradient * direction).sum().item()
    assert slope == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-5)


def start(initial: Gaussian) -> TensorDict:
    """What a loss reads of a start belief."""
    belief = {"mean": initial.mean, "var": initial.cov}
    return TensorDict({"observation": belief}, initial.batch_shape)
