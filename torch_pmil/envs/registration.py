"""The robots by their names in gymnasium; a further one is a line in ``ROBOTS``."""

from __future__ import annotations

from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.cart_pole import CartPoleEnv
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.double_pendulum_servo import DoublePendulumServoEnv
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv

try:
    import gymnasium
except ModuleNotFoundError:  # an optional extra
    gymnasium = None

# the environment, and the steps of an episode
ROBOTS = {
    "DoublePendulum-v0": (DoublePendulumEnv, 25),
    "DoublePendulumServo-v0": (DoublePendulumServoEnv, 25),
    "BioRob-v0": (BioRobEnv, 18),
    "Pendubot-v0": (PendubotEnv, 250),
    "Acrobot-v0": (AcrobotEnv, 250),
    "CartPole-v0": (CartPoleEnv, 40),
}


def register_robots() -> None:
    """Register each robot with gymnasium under ``torch_pmil/NAME``, once.

    Without gymnasium this does nothing.
    """
    if gymnasium is None:
        return
    for name, (_, steps) in ROBOTS.items():
        if f"torch_pmil/{name}" not in gymnasium.registry:
            gymnasium.register(
                f"torch_pmil/{name}",
                entry_point="torch_pmil.envs.gymnasium_robot:GymnasiumRobot",
                kwargs={"name": name},
                max_episode_steps=steps,
            )
