"""Simulated robots as TorchRL environments."""

import ctypes.util
import os

if "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # headless pictures; MuJoCo reads it when it is imported

from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.mujoco import MujocoRobotEnv

__all__ = ["DoublePendulumEnv", "MujocoRobotEnv"]
