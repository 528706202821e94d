"""Targets of the double pendulum's tip: their poses, holding torques, and their teacher."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from reproduction.teachers.reaching import (
    COLUMNS,
    ROWS,
    TEST_TARGETS,
    TRAINING_TARGETS,
    demonstrate_reaching,
    holding_torques,
    reaching_teacher,
)
from reproduction.teachers.swing_up import STEPS
from tests.helpers.draws import Draws
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions, pose_at
from torch_pmil.tasks.double_pendulum import distance_from_target

ALL_TARGETS = torch.cat([TRAINING_TARGETS, TEST_TARGETS])


def at_rest(angles: Tensor) -> Tensor:
    return torch.stack([angles, torch.zeros_like(angles)], -1).flatten(-2)


def tip_of(angles: Tensor) -> Tensor:
    return link_positions(at_rest(angles))[..., 2:]


def misses(states: Tensor, targets: Tensor) -> Tensor:
    """Largest distance of the tip in the last 0.5 s, sample by sample."""
    tips = (link_positions(states[:, t])[:, 2:] for t in range(20, 26))
    return torch.stack([(tip - targets).norm(dim=-1) for tip in tips]).amax(0)


def test_tip_is_at_the_target_with_the_elbow_on_the_left(draws: Draws) -> None:
    targets = torch.cat([ALL_TARGETS, draws.uniform(-0.7, 0.7, 5, 20, 2).flatten(0, 1)])
    angles = pose_at(targets)
    torch.testing.assert_close(tip_of(angles), targets, rtol=0, atol=1e-12)
    elbows = link_positions(at_rest(angles))[..., :2]
    assert (targets[..., 0] * elbows[..., 1] - targets[..., 1] * elbows[..., 0] < 0).all()


def test_pose_changes_with_the_target_as_the_inverse_of_the_tip_with_the_pose() -> None:
    for target in ALL_TARGETS:
        by_target = torch.autograd.functional.jacobian(pose_at, target)
        by_pose = torch.autograd.functional.jacobian(tip_of, pose_at(target))
        torch.testing.assert_close(by_target @ by_pose, torch.eye(2).double(), rtol=0, atol=1e-9)


@pytest.mark.parametrize("target", [[0.8, 0.8], [0.0, 0.0], [float("nan"), 0.5]])
def test_target_out_of_reach_is_refused(target: list[float]) -> None:
    message = r"targets must be in the arm's reach, from 0 to 1.0 m from its base, got \["
    with pytest.raises(ValueError, match=message):
        pose_at(torch.tensor([[0.1, 0.1], target], dtype=torch.float64))


def test_holding_torques_are_the_slope_of_the_energy_and_leave_a_quarter_of_the_limit() -> None:
    def energy(angles: Tensor) -> Tensor:  # of two rods of 0.5 kg, whose centres are half way
        inner, outer = link_positions(at_rest(angles))[..., 1::2].unbind(-1)
        return 0.5 * 9.81 * (inner / 2 + (inner + outer) / 2).sum()

    torques, poses = holding_torques(ALL_TARGETS), pose_at(ALL_TARGETS)
    slope = torch.autograd.functional.jacobian(energy, poses)
    torch.testing.assert_close(torques, slope, rtol=0, atol=1e-9)
    assert torques.abs().max() < 0.75 * 3.5
    states = at_rest(poses)  # in which the robot stays
    after = DoublePendulumEnv().simulate(states, torques)
    torch.testing.assert_close(after, states, rtol=0, atol=1e-9)


def test_test_targets_are_a_grid_that_reaches_beyond_the_training_targets_on_all_sides() -> None:
    grid = TEST_TARGETS.reshape(len(ROWS), len(COLUMNS), 2)
    assert (grid[..., 0] == COLUMNS).all() and (grid[..., 1] == ROWS[:, None]).all()
    assert (TEST_TARGETS.amin(0) < TRAINING_TARGETS.amin(0) - 0.09).all()
    assert (TEST_TARGETS.amax(0) > TRAINING_TARGETS.amax(0) + 0.09).all()


def test_each_robot_goes_to_its_own_target_and_stays() -> None:
    targets = TRAINING_TARGETS[[0, 1, 1, 0]]
    states, torques = demonstrate_reaching(DoublePendulumEnv(num_envs=4, seed=5), targets, seed=5)
    assert (states.shape, torques.shape) == ((4, STEPS + 1, 4), (4, STEPS, 2))
    assert (misses(states, targets) < 0.1).all()
    assert torques.abs().max() <= 3.5
    certain = DoublePendulumEnv(num_envs=4, initial_std=[0.0] * 4, seed=5)
    exact, _ = demonstrate_reaching(certain, targets, seed=5, torque_noise=0.0)
    assert (misses(exact, targets) < 0.03).all()


def test_distance_from_the_target_is_the_largest_of_the_last_half_second(draws: Draws) -> None:
    states = draws.normal(35, 26, 4)
    expected = misses(states, TEST_TARGETS)
    torch.testing.assert_close(distance_from_target(states, TEST_TARGETS), expected)
    repeated = distance_from_target(states.expand(2, 35, 26, 4), TEST_TARGETS)
    torch.testing.assert_close(repeated, expected.expand(2, 35))


def test_targets_that_do_not_fit_the_robots_or_that_no_plan_reaches_are_refused() -> None:
    message = r"targets must have shape \(4, 2\), one for each robot, got \(3, 2\)"
    with pytest.raises(ValueError, match=message):
        demonstrate_reaching(DoublePendulumEnv(num_envs=4), TRAINING_TARGETS, seed=0)
    stretched = torch.tensor([0.95, 0.0], dtype=torch.float64)  # 4.9 N·m to hold
    with pytest.raises(RuntimeError, match=r"no plan found within 3.0 N·m .* to the state"):
        reaching_teacher(stretched)


@pytest.mark.slow
def test_all_test_targets_can_be_reached() -> None:
    env = DoublePendulumEnv(num_envs=len(TEST_TARGETS), seed=7)
    states, _ = demonstrate_reaching(env, TEST_TARGETS, seed=7)
    assert (misses(states, TEST_TARGETS) < 0.1).all()
