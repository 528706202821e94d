"""The swing-up of Section 5.1 by a robot that takes angles for its servos, not torques."""

from __future__ import annotations

from dataclasses import replace

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.double_pendulum_servo import DoublePendulumServoEnv
from torch_pmil.experiments.tasks.double_pendulum import double_pendulum
from torch_pmil.experiments.tasks.experiment import Experiment, actions_of


def double_pendulum_servo(demonstrations: Demonstrations | None = None) -> Experiment:
    """The experiment of Section 5.1 with a position servo in each joint, at 10 Hz.

    All but the robot and its actions is that of :func:`double_pendulum`. The first policy holds the
    robot where it starts, and the first motion is around that.

    Args:
        demonstrations: as of :func:`double_pendulum`.

    Raises:
        DemonstrationError: they hold something else, or at another rate.
    """
    env = DoublePendulumServoEnv()
    return replace(
        double_pendulum(demonstrations),
        name="double_pendulum_servo",
        make_env=DoublePendulumServoEnv,
        actions=actions_of(env),
        holding_actions=env.holding_actions,
    )
