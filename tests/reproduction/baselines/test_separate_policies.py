"""Policies of single targets, blended or the nearest."""

from __future__ import annotations

import pytest
import torch

from reproduction.baselines.separate_policies import SeparatePolicies
from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match

SPACE = StateSpace(("q", "dq"), ("rad", "rad/s"), (), joint_match(("q", "dq"), ("rad", "rad/s")))
TARGETS = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]], dtype=torch.float64)


def policies(draws: Draws) -> list[StatePolicy]:
    made = []
    for _ in TARGETS:
        network = RBFPolicy(draws.normal(4, 2), torch.tensor([2.0]), torch.ones(2))
        network.weights.data.copy_(draws.normal(4, 1))
        made.append(StatePolicy(network.requires_grad_(False), SPACE, 0.1))
    return made


@pytest.mark.parametrize("nearest", [False, True])
def test_at_a_training_target_its_own_policy_acts(draws: Draws, nearest: bool) -> None:
    separate, states = policies(draws), draws.normal(5, 2)
    both = SeparatePolicies(separate, TARGETS, nearest)
    for target, policy in zip(TARGETS, separate, strict=True):
        torch.testing.assert_close(both(states, target.expand(5, 2)), policy(states))


def test_blended_torque_is_weighted_by_inverse_square_distances(draws: Draws) -> None:
    separate, state = policies(draws), draws.normal(2)
    target = torch.tensor([0.5, 0.0], dtype=torch.float64)
    weights = torch.tensor([4.0, 4.0, 1 / 4.25], dtype=torch.float64)
    expected = weights @ torch.stack([policy(state) for policy in separate]) / weights.sum()
    torch.testing.assert_close(SeparatePolicies(separate, TARGETS)(state, target), expected)


def test_nearest_policy_acts_alone(draws: Draws) -> None:
    separate, states, targets = policies(draws), draws.normal(6, 2), draws.normal(6, 2)
    action = SeparatePolicies(separate, TARGETS, nearest=True)(states, targets)
    for i in range(6):
        nearest = (targets[i] - TARGETS).square().sum(-1).argmin()
        torch.testing.assert_close(action[i], separate[nearest](states[i]))


def test_policies_that_are_not_one_for_each_target_are_refused(draws: Draws) -> None:
    with pytest.raises(ValueError, match=r"with a policy for each, got \(2, 2\) and 3 policies"):
        SeparatePolicies(policies(draws), TARGETS[:2])
