"""Robots as TorchRL environments, simulated and physical."""

import os

from torch_pmil.envs.opengl import chosen_backend, import_mujoco

try:
    chosen = chosen_backend()
    import_mujoco(chosen)
except (RuntimeError, AttributeError, OSError):
    # a misspelt or broken backend: robots move without pictures, and open_renderer reports it
    import_mujoco("disable")
    os.environ["MUJOCO_GL"] = chosen

from torch_pmil.envs.adapter import AdaptedEnv, CosSin
from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.cart_pole import CartPoleEnv
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.double_pendulum_servo import DoublePendulumServoEnv
from torch_pmil.envs.history import History, HistoryEnv
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv
from torch_pmil.envs.registration import register_robots

__all__ = [
    "AcrobotEnv",
    "AdaptedEnv",
    "BioRobEnv",
    "CartPoleEnv",
    "CosSin",
    "DoublePendulumEnv",
    "DoublePendulumServoEnv",
    "History",
    "HistoryEnv",
    "MujocoRobot",
    "MujocoRobotEnv",
    "PendubotEnv",
    "PhysicalRobotEnv",
]

register_robots()
