"""Torques of exact tracking: a robot that applies them moves as the other one did."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from reproduction.teachers.exact_tracking import motion_of
from tests.helpers.draws import Draws
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, double_pendulum_model
from torch_pmil.envs.joint_torques import tracking_torques

STEPS = 4


@pytest.fixture(scope="module")
def motion() -> tuple[Tensor, Tensor, Tensor]:
    """0.4 s of the paper's double pendulum under random torques."""
    env, torques = DoublePendulumEnv(seed=0), Draws(seed=0).uniform(-2.0, 2.0, STEPS, 2)
    states = [env.reset()["observation"]]
    for torque in torques:
        states.append(env.simulate(states[-1][None], torque[None])[0])
    return motion_of(env, torch.stack(states), torques)


def test_motion_holds_every_time_step_from_the_first_state_on(
    motion: tuple[Tensor, Tensor, Tensor],
) -> None:
    env, (states, accelerations, torques) = DoublePendulumEnv(seed=0), motion
    assert (states.shape, accelerations.shape, torques.shape) == ((200, 4), (200, 2), (200, 2))
    following = env.simulate(states[::50], torques[::50])
    torch.testing.assert_close(states[50::50], following[:-1], rtol=0, atol=1e-12)
    same = (torques[1:] == torques[:-1]).all(-1)
    slopes = states[:, 1::2].diff(dim=0)[same] / 0.002
    means = (accelerations[1:] + accelerations[:-1])[same] / 2
    torch.testing.assert_close(slopes, means, rtol=0, atol=0.05)
    needed = tracking_torques(double_pendulum_model(), states, accelerations)
    torch.testing.assert_close(needed, torques, rtol=0, atol=1e-9)


def test_torques_are_affine_in_the_mass_of_the_second_link(
    motion: tuple[Tensor, Tensor, Tensor],
) -> None:
    light, middle, heavy = (
        tracking_torques(double_pendulum_model((0.5, mass)), *motion[:2])
        for mass in (0.2, 0.5, 1.1)
    )
    torch.testing.assert_close((heavy - middle) / 0.6, (middle - light) / 0.3)
    assert (heavy - light).abs().max() > 1


@pytest.mark.parametrize("mass", [0.15, 1.0])
def test_another_robot_under_its_tracking_torques_moves_as_the_first_one_did(
    motion: tuple[Tensor, Tensor, Tensor], mass: float
) -> None:
    states, accelerations, torques = motion
    model = double_pendulum_model((0.5, mass))
    model.actuator_ctrllimited[:] = 0
    followed = follow(model, states, tracking_torques(model, states, accelerations))
    unfollowed = follow(model, states, torques)
    errors = [np.abs(way - states[1:].numpy()).max() for way in (followed, unfollowed)]
    assert errors[0] < 0.02 * errors[1]


def follow(model: mujoco.MjModel, states: Tensor, torques: Tensor) -> np.ndarray:
    """States (S - 1, 4) from the first state on, each torque held for a time step."""
    data, followed = mujoco.MjData(model), []
    data.qpos[:], data.qvel[:] = states[0, ::2], states[0, 1::2]
    for torque in torques[:-1]:
        data.ctrl[:] = torque
        mujoco.mj_step(model, data)
        followed.append(np.stack([data.qpos, data.qvel], -1).ravel())
    return np.array(followed)
