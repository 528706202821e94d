"""The expected cost of any function, beside one that is known in closed form."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.losses import HORIZON, SPACE, WIDTH, make_parts, start_belief
from torch_pmil.model.sampled_rollouts import SampledPrediction
from torch_pmil.search.sampled_cost import CostFunction, ExpectedSampledCost
from torch_pmil.search.target_losses import ExpectedQuadraticCost

TARGET = torch.tensor([0.1, 0.4], dtype=torch.float64)


def of_place(states: Tensor, actions: Tensor) -> Tensor:
    """The quadratic cost of the tip's distance from the target."""
    return ((SPACE.observe(states) - TARGET) / WIDTH).square().sum(-1)


def loss_of(cost: CostFunction, count: int = 500) -> ExpectedSampledCost:
    parts = make_parts(Draws(0))
    return ExpectedSampledCost(*parts, SPACE, cost, HORIZON, prediction=SampledPrediction(count))


@torch.no_grad()
def test_cost_of_a_distance_is_that_of_exact_moments() -> None:
    """One step from a start is exact by moments too, for a quadratic cost."""
    initial, loss = start_belief(Draws(1)), loss_of(of_place, 100_000)
    exact = ExpectedQuadraticCost(*make_parts(Draws(0)), SPACE, TARGET, WIDTH, HORIZON)
    first, expected = loss.per_step(initial, 1), exact.per_step(initial, 1)
    states = loss.prediction.rollouts(initial, loss.actor_network, loss.dynamics, SPACE, 1)
    error = loss.sample_costs(states).std() / 100_000**0.5
    assert (first - expected).abs().item() < 4 * error.item()


@torch.no_grad()
def test_actions_are_those_that_lead_to_the_states(draws: Draws) -> None:
    loss = loss_of(lambda states, actions: actions[..., 0] + 0 * states[..., 0])
    states = draws.normal(7, HORIZON + 1, 2)
    expected = loss.actor_network(SPACE.features(states[:, :-1]))[..., 0]
    assert_close(loss.sample_costs(states), expected)


def test_loss_is_the_sum_of_its_steps_and_has_their_gradient() -> None:
    initial, loss = start_belief(Draws(1)), loss_of(of_place)
    belief = TensorDict({"observation": {"mean": initial.mean, "var": initial.cov}})
    total = loss(belief)["loss_cost"]
    assert_close(total, loss.per_step(initial).sum())
    total.backward()
    assert all(each.grad.isfinite().all() for each in loss.actor_network.parameters())
    weights = loss.actor_network.weights
    slope, step, values = weights.grad[0, 0].item(), 1e-5, []
    for move in (step, -2 * step):
        weights.data[0, 0] += move
        values.append(loss.per_step(initial).sum().item())
    assert slope == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-4)


@pytest.mark.parametrize(
    ("cost", "error", "message"),
    [
        (lambda states, actions: 1.0, TypeError, r"must return a tensor \(500, 4\), got float"),
        (lambda states, actions: states, ValueError, r"must return \(500, 4\) for states"),
        (lambda states, actions: (states[..., 0] - 99).sqrt(), ValueError, "got nan at q = .*, dq"),
        (lambda states, actions: actions[..., 0].detach(), ValueError, "must be differentiable"),
    ],
)
def test_what_is_no_cost_is_refused(cost: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        loss_of(cost).per_step(start_belief(Draws(1)))


def test_beliefs_have_no_cost_in_closed_form() -> None:
    initial = start_belief(Draws(1), 2)
    rollout = TensorDict({"next": {"observation": {"mean": initial.mean, "var": initial.cov}}}, [])
    with pytest.raises(NotImplementedError, match="no expectation in closed form"):
        loss_of(of_place).rollout_loss(rollout)
