"""Simulated robots as TorchRL environments."""

from torch_pmil.envs.adapter import AdaptedEnv, CosSin
from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.envs.registration import register_robots

__all__ = ["AdaptedEnv", "BioRobEnv", "CosSin", "DoublePendulumEnv", "MujocoRobotEnv"]

register_robots()
