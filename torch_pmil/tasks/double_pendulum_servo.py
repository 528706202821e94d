"""The swing-up of Section 5.1 by a robot that takes angles for its servos, not torques."""

from __future__ import annotations

from dataclasses import replace

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.double_pendulum_servo import DoublePendulumServoEnv
from torch_pmil.tasks.double_pendulum import double_pendulum
from torch_pmil.tasks.fitting import actions_of
from torch_pmil.tasks.method import SURE
from torch_pmil.tasks.task import Task

# a tenth of the motors': of the same weight, the torque of a servo at kp = 10 N·m/rad whose
# setpoints go up to 4 rad is some ten times that of a motor of 3.5 N·m
WEIGHT_STD = 0.01


def double_pendulum_servo(demonstrations: Demonstrations | None = None) -> Task:
    """The experiment of Section 5.1 with a position servo in each joint, at 10 Hz.

    The first policy holds the robot where it is, at the start and along what was demonstrated, and
    the first motion is around what holds the start. All else, arguments and errors too, is as in
    :func:`double_pendulum`.
    """
    task, env = double_pendulum(demonstrations), DoublePendulumServoEnv()
    # positions that follow from velocities would make this model too sure: promises were broken
    return replace(
        task.with_settings(initial_weight_std=WEIGHT_STD, velocities_alone=False, search=SURE),
        name="double_pendulum_servo",
        make_env=DoublePendulumServoEnv,
        actions=actions_of(env),
        holding_actions=env.holding_actions,
        held_states=task.demonstrated_states,
    )
