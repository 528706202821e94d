"""How near the BioRob's racket comes to the ball in trajectories that its model imagines.

A model of joint angles and speeds knows no contact, so the racket is moved along the imagined
angles, without forces.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import torch
from scipy.interpolate import CubicHermiteSpline
from torch import Tensor

from torch_pmil.envs.biorob import JOINTS, biorob_model

PER_STEP = 10  # poses in which the distance is measured


def imagined_distance_from_ball(states: Tensor, time_step: float) -> Tensor:
    """Least distance (m) of racket and ball, 0 where they touch; of their surfaces.

    Between two states the joints follow the cubic polynomials through their angles and speeds.

    Args:
        states: x_0..x_T, (B, T + 1, 6).
        time_step: between two states, s.

    Returns:
        (B,).

    Example:
        >>> still = torch.tensor([-0.15, 0.35, 1.2, 0.0, 0.0, 0.0]).expand(1, 3, 6)
        >>> imagined_distance_from_ball(still, 0.1) > 0.2
        tensor([True])
    """
    angles, speeds = states[..., :3].numpy(), states[..., 3:].numpy()
    times = time_step * np.arange(states.shape[1])
    fine = np.linspace(0, times[-1], PER_STEP * (len(times) - 1) + 1)[1:]
    poses = CubicHermiteSpline(times, angles, speeds, axis=1)(fine)
    least = [min(map(_distance, motion)) for motion in poses]
    return torch.tensor(least, dtype=torch.float64).clamp(min=0)


def _distance(pose: np.ndarray) -> float:
    """Distance (m) of the surfaces of racket and ball in a pose (3,) of the joints."""
    model, data = _scene()
    for joint, angle in zip(JOINTS, pose, strict=True):
        data.joint(joint).qpos[:] = angle
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_sensorPos(model, data)
    return data.sensor("racket_ball_distance").data.item()


@cache
def _scene() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = biorob_model()
    return model, mujoco.MjData(model)
