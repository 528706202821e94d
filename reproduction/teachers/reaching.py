"""Places that the double pendulum's tip reaches and holds: one task with many targets.

A target eta is the place [x, y] of the tip in m, as ``link_positions`` gives it. All are below the
base, the elbow always to their left, so that the pose is a smooth function of the target. Holding
them takes up to 2.3 of the 3.5 N·m; in many of them the outer link points upward and falls without
feedback. A place counts as reached within 0.1 m, and the training targets are 0.28 m to 0.4 m from
each other: who goes to the nearest of them instead reaches no other place of the grid. The grid of
test targets surrounds the triangle of the training targets and extends 0.1 m beyond it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from reproduction.teachers.swing_up import STEPS, TORQUE_NOISE, demonstrate, teacher_for
from reproduction.teachers.trajectory_optimization import (
    Array,
    QuadraticCost,
    TrackingController,
)
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, double_pendulum_model, pose_at
from torch_pmil.envs.joint_torques import tracking_torques

# (3, 2), m
TRAINING_TARGETS = torch.tensor([[0.1, -0.6], [0.5, -0.6], [0.3, -0.4]], dtype=torch.float64)
COLUMNS = torch.arange(0, 7, dtype=torch.float64) / 10  # x of the test targets, m
ROWS = torch.arange(-7, -2, dtype=torch.float64) / 10  # y of the test targets, m
TEST_TARGETS = torch.cartesian_prod(ROWS, COLUMNS).flip(-1)  # (35, 2), m; row by row from below
# of the plan at each step: it goes there at once, and is there after about 1.5 s
STATE_WEIGHTS = (10.0, 2.0, 10.0, 2.0)
ACTION_WEIGHTS = (0.5, 0.5)  # of the torques beside those that hold the target


def holding_torques(targets: Tensor) -> Tensor:
    """Torques (N, 2), in N·m, that hold the tip at targets (N, 2), in m.

    Example:
        >>> holding_torques(TEST_TARGETS).abs().amax(0)
        tensor([2.3395, 1.2263], dtype=torch.float64)
    """
    still = torch.zeros(len(targets), 2)
    return tracking_torques(double_pendulum_model(), _resting_at(targets), still)


def reaching_teacher(target: Tensor) -> TrackingController:
    """Plan the motion from hanging to a target, and a controller that tracks it and holds there.

    Args:
        target: [x, y] of the tip, (2,), m.

    Returns:
        The controller, a function of step (0..24) and states (N, 4) that returns torques (N, 2) in
        N·m, at most 3.5.

    Raises:
        ValueError: the target is out of the arm's reach.
        RuntimeError: the plan does not get there.
    """
    torque = holding_torques(target[None])[0].numpy()
    guess = torque * np.linspace(0.0, 1.0, STEPS)[:, None]
    cost = QuadraticCost(
        _resting_at(target).numpy(),
        np.tile(STATE_WEIGHTS, (STEPS + 1, 1)),
        np.array(ACTION_WEIGHTS),
        hold_action=torque,
    )
    return teacher_for(cost, guess)


def demonstrate_reaching(
    env: DoublePendulumEnv, targets: Tensor, seed: int, torque_noise: float = TORQUE_NOISE
) -> tuple[Tensor, Tensor]:
    """Let the teachers of N targets move N double pendulums at once, with noise on their torques.

    Args:
        env: the N robots, which draw the starts.
        targets: where each is to go, (N, 2), m.
        seed: of the noise.
        torque_noise: standard deviation of what is added to the torques, drawn anew at each step,
            in N·m.

    Returns:
        States x_0..x_T, (N, T + 1, 4), and the torques that were applied, (N, T, 2), in N·m.

    Raises:
        ValueError: there is not a target for each robot, or one is out of reach.
        RuntimeError: a plan does not get there.
    """
    if targets.shape != (*env.batch_size, 2):
        raise ValueError(
            f"targets must have shape {(*env.batch_size, 2)}, one for each robot, got "
            f"{tuple(targets.shape)}"
        )
    teachers = {
        target: reaching_teacher(torch.tensor(target).double())
        for target in set(map(tuple, targets.tolist()))
    }
    of_robot = [teachers[tuple(target)] for target in targets.tolist()]

    def teacher(step: int, states: Array) -> Array:
        return np.stack([own(step, state) for own, state in zip(of_robot, states, strict=True)])

    return demonstrate(env, teacher, seed, torque_noise)


def _resting_at(targets: Tensor) -> Tensor:
    """States (*batch, 4) at rest with the tip at targets (*batch, 2)."""
    pose = pose_at(targets)
    return torch.stack([pose, torch.zeros_like(pose)], dim=-1).flatten(-2)
