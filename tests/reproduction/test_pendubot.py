"""The published equations against MuJoCo, and what the robustness score counts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from reproduction.pendubot_plant import STEPS, TIME_STEP, Plant, accelerations, stacked, stepped
from reproduction.pendubot_robustness import (
    LEVELS,
    PROFILES,
    PUSH_TORQUES,
    cases,
    criteria,
    fraction,
    push_profiles,
    varied_plants,
)
from tests.helpers.draws import Draws
from torch_pmil.envs.pendubot import PendubotEnv


def idle(step: int, states: torch.Tensor) -> torch.Tensor:
    return torch.zeros(len(states), 1).double()


def test_equations_move_as_the_simulated_robot(draws: Draws) -> None:
    states = 3 * draws.normal(5, 4)
    torques = torch.tensor([[-6.0], [-1.0], [0.0], [2.0], [6.0]]).double()
    simulated = PendubotEnv().simulate(states, torques)
    both = torch.cat([torques, torch.zeros_like(torques)], -1)
    for _ in range(round(0.04 / TIME_STEP)):
        states = stepped(stacked([Plant()] * 5), states, both)
    torch.testing.assert_close(states, simulated, rtol=1e-7, atol=1e-7)


def test_friction_brakes_and_inertia_of_motors_slows() -> None:
    state = torch.tensor([[0.0, 1.0, 0.0, 0.0]]).double()
    still = torch.zeros(1, 2).double()
    for braked in (Plant(b1=0.1), Plant(cf1=0.1)):
        assert accelerations(stacked([braked]), state, still)[0, 0] < 0
    torque = torch.tensor([[1.0, 0.0]]).double()
    slow, fast = (
        accelerations(stacked([plant]), torch.zeros(1, 4).double(), torque)[0, 0]
        for plant in (Plant(Ir=1e-4), Plant())
    )
    assert slow < fast


def test_each_parameter_is_varied_alone_around_the_published_one() -> None:
    plants = stacked(varied_plants())
    nominal = stacked([Plant()])
    changed = torch.stack([~plants[name].isclose(nominal[name]) for name in plants])
    assert changed.shape == (10, 10 * LEVELS)
    assert (changed.sum(0) <= 1).all()
    assert (changed.sum(1) == LEVELS - 1).all()


def test_criteria_have_the_published_numbers_of_cases() -> None:
    known = criteria(np.random.default_rng(0))
    counts = {name: len(own.plants) // own.repetitions for name, own in known.items()}
    of_levels = "velocity_noise", "torque_noise", "torque_response", "delay"
    expected = {"model": 10 * LEVELS, "perturbations": PROFILES}
    assert counts == expected | dict.fromkeys(of_levels, LEVELS)


def test_pushes_are_bells_of_either_sign_at_least_a_second_from_both_ends() -> None:
    pushes = push_profiles(np.random.default_rng(0))
    assert pushes.shape == (STEPS, PROFILES)
    peaks = pushes.abs().amax(0)
    assert (peaks > 0.5 * PUSH_TORQUES[0]).all()
    assert (peaks <= 3 * PUSH_TORQUES[1]).all()
    assert pushes.min() < 0 < pushes.max()


@pytest.mark.slow
def test_a_robot_that_hangs_fails() -> None:
    assert fraction(idle, cases([Plant()] * 2), 0, torch.Generator()) == 0.0
