"""Robots as TorchRL environments, simulated and physical."""

import ctypes.util
import importlib
import os

if "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    # pictures without a display; MuJoCo reads this at its first import
    os.environ.setdefault("MUJOCO_GL", "egl")
try:
    importlib.import_module("mujoco")
except (RuntimeError, AttributeError, OSError):
    # a misspelt or broken backend: robots move without pictures, and open_renderer reports it
    chosen = os.environ.get("MUJOCO_GL", "")
    os.environ["MUJOCO_GL"] = "disable"
    importlib.import_module("mujoco")
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
