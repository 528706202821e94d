"""The physics of the PILCO literature's robots."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from reproduction.pilco_scenarios import CART_DOUBLE, GRAVITY, SCENARIOS, ChainEnv, Scenario


def energy(scenario: Scenario, state: np.ndarray) -> float:
    """Kinetic and potential energy of the rods' points, 200 each, and of the cart."""
    places, rates, n = state[::2], state[1::2], len(scenario.lengths)
    speed = rates[0] if scenario.cart is not None else 0.0
    total, end, velocity = (scenario.cart or 0.0) * speed**2 / 2, 0.0, np.array([speed, 0.0])
    share = (np.arange(200) + 0.5) / 200
    for length, mass, q, dq in zip(
        scenario.lengths, scenario.masses, places[-n:], rates[-n:], strict=True
    ):
        along = length * dq * np.array([np.cos(q), -np.sin(q)])
        points = velocity + share[:, None] * along
        height = end + share * length * np.cos(q)
        total += mass * (np.square(points).sum(-1) / 2 + GRAVITY * height).mean()
        end, velocity = end + length * np.cos(q), velocity + along
    return total


@pytest.mark.parametrize("scenario", [*SCENARIOS.values(), CART_DOUBLE])
def test_energy_changes_by_the_work_of_the_motors(scenario: Scenario) -> None:
    """Less that of friction; the energy of points lacks a 40,000th of a rod's inertia."""
    random, h = np.random.default_rng(0), 1e-5
    state = random.standard_normal(len(scenario.state))
    u = 0.5 * np.array(scenario.limits)
    env = ChainEnv(scenario)
    change = (
        energy(scenario, state + h * env._derivative(state, u))
        - energy(scenario, state - h * env._derivative(state, u))
    ) / (2 * h)
    rates = state[1::2]
    if scenario.cart is not None:
        power = u[0] * rates[0] - scenario.friction * rates[0] ** 2
    else:
        relative = np.diff(rates, prepend=0.0)
        power = u @ relative - scenario.friction * relative @ relative
    assert change == pytest.approx(power, abs=1e-3 * (1 + abs(power)))


def test_cart_pole_has_the_published_accelerations() -> None:
    """Those of Deisenroth (2010), whose angle counts from hanging, the other way."""
    cart_pole = SCENARIOS["cart_pole"]
    (length,), (m,), M, b, g = *(cart_pole.lengths, cart_pole.masses), cart_pole.cart, 0.1, GRAVITY
    q, dx, dq, u = 0.7, -0.3, 1.9, 4.0
    theta, dtheta = q - np.pi, dq
    theta, dtheta = -theta, -dtheta
    s, c = np.sin(theta), np.cos(theta)
    ddx = (2 * m * length * dtheta**2 * s + 3 * m * g * s * c + 4 * u - 4 * b * dx) / (
        4 * (M + m) - 3 * m * c**2
    )
    ddtheta = (-3 * m * length * dtheta**2 * s * c - 6 * (M + m) * g * s - 6 * (u - b * dx) * c) / (
        4 * length * (m + M) - 3 * m * length * c**2
    )
    found = cart_pole.acceleration(np.array([0.0, q]), np.array([dx, dq]), np.array([u]))
    assert found == pytest.approx([ddx, -ddtheta], rel=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_tip_is_upright_at_no_angle(name: str) -> None:
    task = SCENARIOS[name].task(name)
    upright = torch.zeros(1, task.space.dim, dtype=torch.float64)
    assert task.space.observe(upright)[0].tolist() == list(task.cost.target.values())
    assert task.initial.mean[::2].tolist() == pytest.approx(
        [torch.pi * (entry[0] == "q") for entry in SCENARIOS[name].state[::2]], abs=0.15
    )
