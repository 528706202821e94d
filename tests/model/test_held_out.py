"""Predictions of what a model has not seen: beside formulas, over spans of time."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.held_out import held_out_loss

NAMES = ("q",)
SPACE = StateSpace(NAMES, ("rad",), (), joint_match(NAMES, ("rad",)))
STEPS, NOISE = 80, torch.tensor(0.05, dtype=torch.float64)


def motion(draws: Draws, tremor: float = 0.0) -> tuple[Tensor, Tensor]:
    """States (T + 1, 1) that half follow actions (T, 1), with a disturbance at each step."""
    actions, state = draws.normal(STEPS, 1), torch.zeros(1, dtype=torch.float64)
    states = [state]
    for action in actions:
        state = 0.5 * state + 0.1 * action + tremor * draws.normal(1)
        states.append(state)
    return torch.stack(states), actions


def loss(states: Tensor, actions: Tensor, span: int, every: int = 1) -> float:
    return held_out_loss(GPDynamics(2, 1), states, actions, SPACE, NOISE, span, every)


def test_perfect_predictions_lose_nothing(draws: Draws) -> None:
    assert 0 <= loss(*motion(draws), span=4) < 2e-3


@pytest.mark.parametrize("span", [1, 4])
def test_disturbances_cost_what_their_variance_tells(draws: Draws, span: int) -> None:
    """A variance v beside that of the noise s costs (log(1 + v/s) + v/(v + s)) / 2 nats."""
    tremor = 0.1
    variance = tremor**2 * sum(0.25**step for step in range(span))
    share = variance / NOISE.item() ** 2
    expected = (math.log1p(share) + share / (1 + share)) / 2
    nats = [loss(*motion(Draws(seed), tremor=tremor), span=span) for seed in range(12)]
    mean, error = torch.tensor(nats).mean().item(), torch.tensor(nats).std().item() / 12**0.5
    # variance and mean are of 64 particles, and the disturbance is estimated from the motion
    assert abs(mean - expected) < 4 * error + 0.1


def test_longer_steps_lose_less_where_readings_are_noisy(draws: Draws) -> None:
    """Over the same time: each step passes through the noise of a reading."""
    actions = draws.normal(STEPS // 4, 1).repeat_interleave(4, 0)
    true = torch.cat([torch.zeros(1, 1).double(), (0.05 * actions).cumsum(0)])
    seen = true + 0.1 * draws.normal(STEPS + 1, 1)
    fine = loss(seen, actions, span=16, every=4)
    coarse = loss(seen[::4], actions[::4], span=4)
    assert coarse < fine


def test_model_that_lacks_an_input_loses_more(draws: Draws) -> None:
    states, actions = motion(draws)
    unseen = torch.zeros_like(actions)
    assert loss(states, unseen, span=4) > loss(states, actions, span=4) + 0.5


def test_motion_must_be_longer_than_the_span(draws: Draws) -> None:
    states, actions = motion(draws)
    with pytest.raises(ValueError, match=r"more than 80 actions, got 81 of 80"):
        loss(states, actions, span=STEPS)
