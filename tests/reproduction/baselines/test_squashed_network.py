"""The squashed network: its formula, its limits, and what drops out of it."""

from __future__ import annotations

import pytest
import torch

from reproduction.baselines.squashed_network import SquashedNetwork
from tests.helpers.draws import Draws
from torch_pmil.control.action_space import ActionSpace

LOW, HIGH = torch.tensor([-2.0, 0.0]).double(), torch.tensor([2.0, 6.0]).double()
ACTIONS = ActionSpace(("a", "b"), ("N", "N"), LOW, HIGH)


def network(draws: Draws, weight: float, count: int = 30) -> SquashedNetwork:
    scale = torch.tensor([0.5, 1.0, 3.0], dtype=torch.float64)
    centres, weights = draws.normal(count, 3), weight * draws.normal(count, 2)
    policy = SquashedNetwork(centres, scale, weights, ACTIONS)
    policy.log_widths.data.copy_(0.3 * draws.normal(3))
    return policy


def test_actions_are_squashed_sums_of_gaussians(draws: Draws) -> None:
    policy, features = network(draws, 1.0), draws.normal(5, 3)
    widths = policy.scale * policy.log_widths.exp()
    away = (features[:, None] - policy.centres * policy.scale) / widths
    total = (-away.square().sum(-1)).exp() @ policy.weights
    expected = torch.tensor([0.0, 3.0]) + torch.tensor([2.0, 3.0]) * total.tanh()
    torch.testing.assert_close(policy(features), expected)


def test_actions_are_within_their_limits(draws: Draws) -> None:
    actions = network(draws, 1e3)(draws.normal(500, 3))
    assert (actions >= LOW).all() and (actions <= HIGH).all()
    assert (actions[:, 0].abs() > 1.99).any()


@pytest.mark.parametrize("dropout", [0.125, 0.25])
def test_dropout_keeps_the_expectation(draws: Draws, dropout: float) -> None:
    policy = network(draws, 1e-4)  # so small that tanh is linear to eight digits
    features = draws.normal(3)
    dropped = policy.controller(dropout, draws.generator)(features.expand(20_000, 3))
    error = dropped.std(0) / len(dropped) ** 0.5
    assert (error > 0).all()
    assert ((dropped.mean(0) - policy(features)).abs() < 4 * error).all()


def test_each_particle_and_each_call_has_its_own_dropout(draws: Draws) -> None:
    policy, features = network(draws, 1.0), draws.normal(3).expand(2, 3)
    act = policy.controller(0.25, draws.generator)
    first, second = act(features), act(features)
    assert not torch.equal(first[0], first[1]) and not torch.equal(first, second)
    torch.testing.assert_close(*policy(features))


def test_nothing_drops_out_of_what_the_gradient_sees_in_vain(draws: Draws) -> None:
    """A basis function that is left out has no gradient, the others count the more."""
    policy = network(draws, 1.0, count=1)
    actions = policy.controller(0.25, draws.generator)(policy.centres * policy.scale.expand(8, 3))
    [slope] = torch.autograd.grad(actions[:, 0].sum(), policy.weights)
    out = actions[:, 0] == 0
    counted = (~out).sum() * 2 * (1 - (policy.weights[0, 0] / 0.75).tanh().square()) / 0.75
    torch.testing.assert_close(slope[0, 0], counted)
