"""The published plant: its mass matrix, its gravity, its energy, and one motor."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv, one_motor_model, tip_height

# published: lengths m, masses kg, centres of mass m, inertias about the joints kg m²
L1, L2 = 0.2, 0.3
M1, M2 = 0.5234602302310271, 0.6255677234174437
R1, R2 = 0.2, 0.25569305436052964
I1, I2 = 0.031887199591513114, 0.05086984812807257
G = 9.81


@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.7, -1.9), (math.pi, 0.4)])
def test_mass_matrix_and_gravity_are_the_published_ones(pose: tuple[float, float]) -> None:
    model = one_motor_model("tau1")
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    matrix = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, matrix)
    coupled = M2 * L1 * R2 * math.cos(pose[1])
    across = I2 + coupled
    expected = [[I1 + I2 + M2 * L1**2 + 2 * coupled, across], [across, I2]]
    np.testing.assert_allclose(matrix, expected, rtol=1e-10)
    # angles from upright: gravity pulls away from 0
    inner, outer = math.sin(pose[0]), math.sin(sum(pose))
    pull = [-G * (M1 * R1 + M2 * L1) * inner - G * M2 * R2 * outer, -G * M2 * R2 * outer]
    np.testing.assert_allclose(data.qfrc_bias, pull, atol=1e-10)


def test_energy_is_kept_without_torque() -> None:
    model = one_motor_model("tau2")
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    data.qpos[:] = 2.0, 1.0
    energies = []
    for _ in range(500):  # 1 s
        mujoco.mj_step(model, data)
        energies.append(data.energy.sum())
    assert np.ptp(energies) < 1e-4 * G * (M1 * R1 + M2 * (L1 + R2))


@pytest.mark.parametrize(("make_env", "moved"), [(PendubotEnv, 0), (AcrobotEnv, 1)])
def test_one_motor_pushes_its_joint_alone(make_env: type[PendubotEnv], moved: int) -> None:
    env = make_env(initial_std=(0.0,) * 4)
    assert env.action_spec.shape == (1,)
    assert env.torque_limits.tolist() == [6.0]
    assert env.model.actuator_trnid[0, 0] == env.model.joint(f"q{moved + 1}").id


def test_tip_height_is_that_of_the_model() -> None:
    env = PendubotEnv(seed=0)
    state = torch.tensor([0.4, 0.0, -1.1, 0.0], dtype=torch.float64)
    env.reset(TensorDict({"observation": state}))
    data = mujoco.MjData(env.model)
    data.qpos[:] = state[::2].numpy()
    mujoco.mj_forward(env.model, data)
    assert tip_height(state).item() == pytest.approx(data.site("tip").xpos[2])
