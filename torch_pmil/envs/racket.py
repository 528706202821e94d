"""Distance of the BioRob's racket from the ball along predicted states."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import scipy
import torch
from torch import Tensor

from torch_pmil.envs.biorob import JOINTS, BioRobEnv

PLACES = 10  # of the racket, between two states


def distance_along(states: Tensor) -> Tensor:
    """Least distance (*batch) of the surfaces of racket and ball, m, float64; 0 if they touch.

    The joints move along the cubic given by the positions and velocities of two states. The ball
    hangs still at its usual place and does not stop the racket.

    Args:
        states: x_0..x_T, (*batch, T + 1, 6), in rad and rad/s.

    Example:
        >>> from torch_pmil.envs.biorob import START
        >>> distance_along(torch.tensor(START).expand(4, 19, 6)).shape
        torch.Size([4])
    """
    model, joints, qpos, period = _robot_at_start()
    paths = _joint_paths(states.detach().double().numpy(), period)
    data, sensor = mujoco.MjData(model), model.sensor("racket_ball_distance").adr[0]
    data.qpos[:] = qpos
    distances = np.empty(paths.shape[:-1])
    for place in np.ndindex(distances.shape):
        data.qpos[joints] = paths[place]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_sensorPos(model, data)
        distances[place] = data.sensordata[sensor]
    return torch.as_tensor(distances.min(-1).clip(min=0))


def _joint_paths(states: np.ndarray, period: float) -> np.ndarray:
    """Positions of the joints, (*batch, PLACES T + 1, 3), along states (*batch, T + 1, 6)."""
    positions, velocities = np.split(states, 2, axis=-1)
    times = period * np.arange(states.shape[-2])
    fine = np.linspace(0, times[-1], PLACES * (len(times) - 1) + 1)
    return scipy.interpolate.CubicHermiteSpline(times, positions, velocities, axis=-2)(fine)


@cache
def _robot_at_start() -> tuple[mujoco.MjModel, list[int], np.ndarray, float]:
    """The robot's model, addresses of its joints, positions of all at the start, control period."""
    env = BioRobEnv(initial_std=torch.zeros(2 * len(JOINTS)), seed=0)
    env.reset()
    model = env.model
    joints = [int(model.joint(name).qposadr[0]) for name in JOINTS]
    positions = env.get_buffer("_physics")[0, 1 : 1 + model.nq].numpy().copy()
    return model, joints, positions, env.control_period
