"""The swing-up of Section 5.1 by a robot that takes angles for its servos, not torques."""

from __future__ import annotations

import math
from dataclasses import replace

from torch import Tensor

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.double_pendulum_servo import DoublePendulumServoEnv
from torch_pmil.experiments.tasks.double_pendulum import double_pendulum
from torch_pmil.experiments.tasks.experiment import Experiment, actions_of

# a tenth of the motors': of the same weight, the torque of a servo at kp = 10 N·m/rad whose
# setpoints go up to 4 rad is some ten times that of a motor of 3.5 N·m
WEIGHT_STD = 0.01


def double_pendulum_servo(demonstrations: Demonstrations | None = None) -> Experiment:
    """The experiment of Section 5.1 with a position servo in each joint, at 10 Hz.

    All but the robot, its actions and the first policy is that of :func:`double_pendulum`. That
    policy holds the robot where it is, at the start and along what was demonstrated, and the first
    motion is around what holds the start.

    Args:
        demonstrations: as of :func:`double_pendulum`.

    Raises:
        DemonstrationError: they hold something else, or at another rate.
    """
    task, env = double_pendulum(demonstrations), DoublePendulumServoEnv()
    states = task.demonstrated_states.unflatten(0, task.demonstrations.positions.shape[:2])
    states = without_turns(states, env.initial_mean).flatten(0, 1)
    return replace(
        task,
        name="double_pendulum_servo",
        make_env=DoublePendulumServoEnv,
        actions=actions_of(env),
        initial_weight_std=WEIGHT_STD,
        demonstrated_states=states,
        holding_actions=env.holding_actions,
        held_states=states,
    )


def without_turns(states: Tensor, start: Tensor) -> Tensor:
    """States [q1, dq1, q2, dq2], (N, T, 4), whose first angles are those nearest to a start (4,).

    Positions tell angles but for whole turns, which a servo's target does not.

    Example:
        >>> import torch
        >>> turned = torch.tensor([[[-3.0, 0.0, 6.28, 0.0], [-2.5, 0.0, 7.28, 0.0]]])
        >>> without_turns(turned, torch.tensor([3.14, 0.0, 0.0, 0.0])).round(decimals=2) + 0.0
        tensor([[[3.2800, 0.0000, 0.0000, 0.0000],
                 [3.7800, 0.0000, 1.0000, 0.0000]]])
    """
    turns = ((states[:, :1] - start) / (2 * math.pi)).round()
    turns[..., 1::2] = 0
    return states - 2 * math.pi * turns
