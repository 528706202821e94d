"""Behavioural cloning: it does what the recorded pairs show, and says what is wrong with them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from reproduction.baselines.behavioral_cloning import clone_behavior
from tests.helpers.draws import Draws
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.tasks.double_pendulum import double_pendulum_space

SPACE, U_MAX = double_pendulum_space(), torch.tensor([3.5, 2.0], dtype=torch.float64)


def demonstrator(states: Tensor) -> Tensor:
    """A smooth policy within the limits."""
    q1, dq1, q2, dq2 = states.unbind(-1)
    return torch.stack([1.5 * q1.sin() - 0.5 * dq1, (q1 - q2).cos() + 0.2 * dq2], -1)


def states_near_upright(draws: Draws, count: int) -> Tensor:
    return draws.uniform(-1.0, 1.0, count, 4)


def test_clone_acts_as_the_demonstrator_where_it_was_not_seen_and_on_robots(draws: Draws) -> None:
    states, others = states_near_upright(draws, 150), states_near_upright(draws, 50)
    policy = clone_behavior(states, demonstrator(states), SPACE, U_MAX, 0.1)
    assert (policy(others) - demonstrator(others)).abs().max() < 0.1
    assert policy.control_period == 0.1
    rollout = DoublePendulumEnv(num_envs=3, seed=0).rollout(2, policy.as_tensordict_module())
    torch.testing.assert_close(rollout["action"], policy(rollout["observation"]))


def test_clone_is_the_squashed_mean_of_a_gp(draws: Draws) -> None:
    states, others = states_near_upright(draws, 40), states_near_upright(draws, 10)
    torques = demonstrator(states) + 0.1 * draws.normal(40, 2).clamp(-1, 1)
    gp = GPDynamics(6, 2)
    gp.fit(SPACE.features(states), torch.asin(torques / U_MAX))
    expected = U_MAX * gp.expansion.mean(SPACE.features(others)).sin()
    policy = clone_behavior(states, torques, SPACE, U_MAX, 0.1)
    torch.testing.assert_close(policy(others), expected, rtol=0, atol=1e-10)


def test_noise_of_the_torques_is_averaged_out(draws: Draws) -> None:
    states, noise = states_near_upright(draws, 200), 0.2 * draws.normal(200, 2).clamp(-1, 1)
    policy = clone_behavior(states, demonstrator(states) + noise, SPACE, U_MAX, 0.1)
    assert (policy(states) - demonstrator(states)).std() < 0.5 * noise.std()


def test_turned_angles_are_the_same_angles(draws: Draws) -> None:
    states = states_near_upright(draws, 40)
    policy = clone_behavior(states, demonstrator(states), SPACE, U_MAX, 0.1)
    turned = states + 2 * torch.pi * torch.tensor([1.0, 0.0, -1.0, 0.0])
    torch.testing.assert_close(policy(turned), policy(states), rtol=0, atol=1e-5)


def test_torques_at_their_limit_are_learned_and_never_exceeded(draws: Draws) -> None:
    states = states_near_upright(draws, 60)
    torques = U_MAX * (3 * states[:, [0, 2]]).clamp(-1, 1)
    policy = clone_behavior(states, torques, SPACE, U_MAX, 0.1)
    assert (policy(10 * states).abs() <= U_MAX).all()
    assert policy(torch.tensor([0.8, 0.0, 0.0, 0.0]))[0] > 0.8 * U_MAX[0]


@pytest.mark.parametrize(
    ("states", "torques", "complaint"),
    [
        ((5, 3, 0.0), (5, 2, 0.0), r"be \(S, 4\) and torques \(S, 2\), got \(5, 3\) and \(5, 2\)"),
        ((5, 4, 0.0), (4, 2, 0.0), r"be \(S, 4\) and torques \(S, 2\), got \(5, 4\) and \(4, 2\)"),
        ((5, 4, 0.0), (5, 2, 3.0), r"finite and within ± \[3.5, 2.0\] N·m, got \[3.0, 3.0\]"),
        ((5, 4, 0.0), (5, 2, torch.nan), r"torques must be finite and within .* got \[nan, nan\]"),
        ((5, 4, torch.nan), (5, 2, 0.0), "inputs must be finite, got nan"),
    ],
)
def test_bad_pairs_are_refused(states: tuple, torques: tuple, complaint: str) -> None:
    """Given by their shapes and the value of all entries."""
    given = (torch.full(shape, value) for *shape, value in (states, torques))
    with pytest.raises(ValueError, match=complaint):
        clone_behavior(*given, SPACE, U_MAX, 0.1)
