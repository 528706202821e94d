"""The published plant: its equations of motion, its one motor, its start."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from torch_pmil.envs import CartPoleEnv

# published: length of the pole m, masses of pole and cart kg, friction N·s/m, gravity m/s²
L, M_POLE, M_CART, B, G = 0.6, 0.5, 0.5, 0.1, 9.82
FASTEST = 20.0  # rad/s, about the rate at which the fastest of the motions below changes
TOLERANCE = FASTEST * (FASTEST * 0.002) ** 4  # of the velocities, by the order of Runge-Kutta


def published(time: float, state: np.ndarray, force: float) -> list[float]:
    """Derivative of [x, dx, q, dq] by the equations of PILCO, whose angle is 0 hanging."""
    _, dx, q, dq = state
    theta, dtheta = math.pi - q, -dq
    s, c = math.sin(theta), math.cos(theta)
    spin, pull = M_POLE * L * dtheta**2 * s, force - B * dx
    inertia = 4 * (M_CART + M_POLE) - 3 * M_POLE * c**2
    ddx = (2 * spin + 3 * M_POLE * G * s * c + 4 * pull) / inertia
    ddtheta = (-3 * spin * c - 6 * (M_CART + M_POLE) * G * s - 6 * pull * c) / (L * inertia)
    return [dx, ddx, dq, -ddtheta]


def test_motion_is_that_of_the_published_equations() -> None:
    env, generator = CartPoleEnv(), np.random.default_rng(0)
    states = generator.uniform(-1, 1, (20, 4)) * [1.0, 2.0, math.pi, 8.0]
    forces = generator.uniform(-10, 10, (20, 1))
    after = env.simulate(torch.from_numpy(states), torch.from_numpy(forces))
    for state, (force,), found in zip(states, forces, after.numpy(), strict=True):
        tight = {"rtol": 1e-12, "atol": 1e-12}
        exact = solve_ivp(published, (0, 0.1), state, "DOP853", args=(force,), **tight)
        np.testing.assert_allclose(found, exact.y[:, -1], rtol=0, atol=TOLERANCE)


def test_one_motor_pushes_the_cart_within_its_limit() -> None:
    env = CartPoleEnv()
    assert (env.action_names, env.action_units) == (("force",), ("N",))
    assert env.torque_limits.tolist() == [10.0]
    assert env.model.actuator_trnid[0, 0] == env.model.joint("x").id
    start, forces = env.initial_mean.expand(2, 4), torch.tensor([[10.0], [30.0]]).double()
    assert env.simulate(start, forces).unique(dim=0).shape == (1, 4)


def test_starts_hang_at_rest_with_the_published_deviations() -> None:
    """Within five standard errors of mean and deviation."""
    count = 4000
    starts = CartPoleEnv(num_envs=count, seed=0).reset()["observation"]
    hanging = torch.tensor([0.0, 0.0, math.pi, 0.0]).double()
    assert ((starts.mean(0) - hanging).abs() < 5 * 0.1 / math.sqrt(count)).all()
    assert ((starts.std(0) / 0.1 - 1).abs() < 5 / math.sqrt(2 * count)).all()


def test_limit_that_is_none_is_refused_in_its_unit() -> None:
    line = "^torque_limit must be one or 1 positive finite numbers in N, got -1.0$"
    with pytest.raises(ValueError, match=line):
        CartPoleEnv(torque_limit=-1.0)
