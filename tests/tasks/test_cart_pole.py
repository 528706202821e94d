"""The cart-pole's task: what it matches, what a success is, what its demonstrations show."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import torch
from torch import Tensor
from torch.testing import assert_close

from torch_pmil.envs.cart_pole import POLE_LENGTH, cart_pole_model
from torch_pmil.tasks.cart_pole import (
    FINAL_SAMPLES,
    SUCCESS_DISTANCE,
    cart_pole_space,
    distance_from_goal,
)
from torch_pmil.tasks.registry import load_experiment

GOAL = torch.tensor([0.0, POLE_LENGTH], dtype=torch.float64)


def standing(x: float = 0.0, q: float = 0.0) -> Tensor:
    """States (31, 4) of a cart that stands at x with its pole at q."""
    return torch.tensor([x, 0.0, q, 0.0], dtype=torch.float64).repeat(31, 1)


def test_task_is_3_s_at_10_hz_with_one_force() -> None:
    task = load_experiment("cart_pole")
    assert (task.horizon, task.demonstrations.time_step) == (30, 0.1)
    assert str(task.actions) == "force (N) from -10 to 10"
    assert task.space.feature_names == ("x", "dx", "dq", "sin q", "cos q")


def test_positions_are_those_of_the_model() -> None:
    model = cart_pole_model()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, -1.1
    mujoco.mj_forward(model, data)
    seen = cart_pole_space().observe(torch.tensor([0.3, 0.0, -1.1, 0.0], dtype=torch.float64))
    x, _, z = data.site("tip").xpos
    assert_close(seen, torch.tensor([data.body("cart").xpos[0], x, z]).double())


def test_demonstrations_start_hanging_and_succeed() -> None:
    task = load_experiment("cart_pole")
    positions = task.demonstrations.positions
    assert (positions[:, 0, 2] < -0.9 * POLE_LENGTH).all()
    states = task.demonstrated_states.unflatten(0, positions.shape[:2])
    assert_close(cart_pole_space().observe(states), positions)
    assert (distance_from_goal(states, GOAL) < SUCCESS_DISTANCE / 3).all(), "with room to spare"
    assert (states[..., 2].diff(dim=-1).abs() < math.pi / 2).all(), "no jump of a turn"


def test_success_is_a_tip_at_the_goal_and_over_the_cart_to_the_end() -> None:
    aside, fallen, swung = standing(), standing(), standing()
    aside[-FINAL_SAMPLES, 0] = SUCCESS_DISTANCE + 0.01
    fallen[-1, 2] = 2 * math.asin((SUCCESS_DISTANCE + 0.01) / 2 / POLE_LENGTH)
    swung[:-FINAL_SAMPLES] = standing(1.0, math.pi)[:-FINAL_SAMPLES]
    q = 1.2 * SUCCESS_DISTANCE / POLE_LENGTH
    leaning = standing(-POLE_LENGTH * math.sin(q), q)  # whose tip is at the goal, nearly
    rollouts = torch.stack([standing(), swung, aside, fallen, leaning])
    distances = distance_from_goal(rollouts, GOAL)
    assert (distances <= SUCCESS_DISTANCE).tolist() == [True, True, False, False, False]
    tip = cart_pole_space().observe(leaning)[-1, 1:]
    assert (tip - GOAL).norm() < SUCCESS_DISTANCE / 2


def test_goal_is_where_the_demonstrations_end() -> None:
    shown = load_experiment("cart_pole").demonstrations
    aside = torch.tensor([0.3, 0.3, 0.0], dtype=torch.float64)
    task = load_experiment("cart_pole", replace(shown, positions=shown.positions + aside))
    succeeded = [task.error.of_states(standing(x)) <= task.tolerance for x in (0.0, 0.3)]
    assert succeeded == [False, True]
