"""Simulated robots as TorchRL environments."""

import ctypes.util
import os

if "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    # pictures without a display; MuJoCo reads this when it is first imported
    os.environ.setdefault("MUJOCO_GL", "egl")

from torch_pmil.envs.adapter import AdaptedEnv, CosSin
from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.envs.registration import register_robots

__all__ = ["AdaptedEnv", "BioRobEnv", "CosSin", "DoublePendulumEnv", "MujocoRobotEnv"]

register_robots()
