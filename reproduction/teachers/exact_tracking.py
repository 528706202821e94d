"""A recorded motion at every time step of the simulation, from which tracking torques follow."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from torch_pmil.envs.mujoco import MujocoRobotEnv


def motion_of(
    env: MujocoRobotEnv, states: Tensor, torques: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """A recorded rollout at every time step of the simulation.

    Args:
        env: the robot that moved.
        states: x_0..x_T at the control rate, (T + 1, D).
        torques: held from each of them on, N·m, (T, F).

    Returns:
        States (S, D), accelerations (S, D/2) and applied torques (S, F) at the S = T * substeps
        time steps.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> env = DoublePendulumEnv(seed=0)
        >>> _, accelerations, _ = motion_of(env, torch.zeros(2, 4), torch.zeros(1, 2))
        >>> accelerations.shape, bool((accelerations == 0).all())
        (torch.Size([50, 2]), True)
    """
    fine = [
        torch.cat([state[None], env.substates(state, torque, env.substeps)[:-1]])
        for state, torque in zip(states[:-1], torques, strict=True)
    ]
    held = torques.repeat_interleave(env.substeps, 0)
    motion = torch.cat(fine)
    return motion, accelerations_of(env.model, motion, held), held


def accelerations_of(model: mujoco.MjModel, states: Tensor, torques: Tensor) -> Tensor:
    """Joint accelerations (S, D/2) in states (S, D) under torques (S, F).

    Every joint has its motor and is in the state.
    """
    data, result = mujoco.MjData(model), np.empty((len(states), model.nv))
    for row, (state, torque) in enumerate(zip(states.numpy(), torques.numpy(), strict=True)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = state[::2], state[1::2], torque
        mujoco.mj_forward(model, data)
        result[row] = data.qacc
    return torch.from_numpy(result)
