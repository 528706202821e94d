"""The physics of the study of own parts: those of the robot, where its masses are known."""

from __future__ import annotations

import pytest
import torch

from reproduction import own_parts
from tests.helpers.draws import Draws
from torch_pmil.envs.cart_pole import POLE_LENGTH, CartPoleEnv
from torch_pmil.tasks.cart_pole import cart_pole


def test_physics_are_those_of_the_robot_whose_masses_are_known(
    draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {"CART": 0.5, "POLE": 0.5, "LENGTH": POLE_LENGTH, "SUBSTEPS": 1000}  # kg, kg, m
    for name, value in known.items():
        monkeypatch.setattr(own_parts, name, value)
    space, states, forces = cart_pole().space, draws.normal(7, 4), 9 * draws.normal(7, 1).tanh()
    changes = own_parts.cart_pole_changes(torch.cat([space.features(states), forces], -1))
    velocities = [space.names.index(name) for name in ("dx", "dq")]
    moved = (CartPoleEnv().simulate(states, forces) - states)[:, velocities]
    torch.testing.assert_close(changes, moved, rtol=0, atol=1e-3)  # of a thousand Euler steps
