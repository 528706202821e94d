"""Tasks of one's own robot and a cost: what is estimated, and what is refused."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil import QuadraticCost, SaturatingCost
from torch_pmil.control.state_space import MatchSpace
from torch_pmil.envs import CartPoleEnv, DoublePendulumEnv
from torch_pmil.envs.rollouts import of_states, rollout_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.tasks.cost_task import REACH, CostTask
from torch_pmil.tasks.own_cost import of_target, own_cost

STATE = ("x", "dx", "q", "dq")
UPRIGHT = SaturatingCost(target={"x": 0.0, "cos q": 1.0}, width=0.5)


def at(*state: float) -> Gaussian:
    return Gaussian(torch.tensor(state).double(), torch.eye(len(state)).double())


def cart_pole(cost: Any = UPRIGHT, **settings: Any) -> CostTask:
    return own_cost(CartPoleEnv(), cost, 40, 0.1, **{"state": STATE, "angles": ("q",)} | settings)


@pytest.fixture(scope="module")
def task() -> CostTask:
    return cart_pole()


def test_target_is_compared_with_entries_and_their_sines_and_cosines(task: CostTask) -> None:
    states = Draws(0).normal(7, 4)
    expected = torch.stack([states[:, 0], states[:, 2].cos()], -1)
    assert_close(task.space.observe(states), expected)
    both = of_target(("sin a", "b"), ("b", "a"), ("m", "rad"), angles=(1,))
    assert_close(both(torch.tensor([3.0, math.pi / 2]).double()), torch.tensor([1.0, 3.0]).double())


def test_entries_that_are_not_named_do_not_count() -> None:
    ends = MatchSpace.of_links(("q1", "q2"), (0.5, 0.5), ("q1", "dq1", "q2", "dq2"))
    cost = QuadraticCost(target={"y2": 1.0}, width=0.5)
    given = {"state": ("q1", "dq1", "q2", "dq2"), "angles": ("q1", "q2"), "match": ends}
    task = own_cost(DoublePendulumEnv(), cost, 25, 0.1, **given).scaled_by(torch.rand(26, 4))
    policy, model = task.make_policy(torch.Generator().manual_seed(0)), GPDynamics(8, 4)
    loss = task.make_loss(policy, model)
    hanging = torch.tensor([[math.pi, 0.0, 0.0, 0.0]]).double()
    states = Gaussian(hanging, torch.zeros(1, 4, 4).double())
    assert loss._costs(task.space.match_space.moments(states)).item() == pytest.approx(16.0)


def test_success_is_to_be_within_a_width_over_the_last_fifth(task: CostTask) -> None:
    """The cart is 0.4 m off, within the width, and farther off before the last eight states."""
    states = torch.zeros(2, 41, 4, dtype=torch.float64)
    states[..., 0] = 0.4
    states[0, :33, 0], states[1, 33, 0] = 3.0, 0.6
    assert (task.error(rollout_of(states)) <= task.tolerance).tolist() == [True, False]


def test_own_success_replaces_that_of_the_cost() -> None:
    task = cart_pole(success=lambda states: states[:, -1, 0] > 1)
    states = torch.zeros(2, 41, 4, dtype=torch.float64)
    states[1, -1, 0] = 2.0
    assert (task.error(rollout_of(states)) <= task.tolerance).tolist() == [False, True]


def test_first_motion_says_how_far_the_centres_spread(task: CostTask) -> None:
    assert task.unscaled
    motion = torch.tensor([0.1, 1.0, 0.2, 5.0]) * Draws(1).normal(41, 4)
    scaled = task.scaled_by(motion)
    assert not scaled.unscaled
    assert_close(scaled.centre_std, torch.maximum(REACH * motion.std(0), task.initial.std))
    assert scaled.settings["centre_std"] == scaled.centre_std.tolist()
    with pytest.raises(RuntimeError, match="after the first motion"):
        task.make_policy(torch.Generator())


def test_settings_of_the_cost_and_the_method_are_known(task: CostTask) -> None:
    assert task.settings["cost"] == UPRIGHT.said
    changed = cart_pole(num_centres=30, **{"search.stage_iterations": 7})
    assert (changed.method.policy.num_centres, changed.method.search.stage_iterations) == (30, 7)
    assert (task.horizon, task.time_step, task.demonstrations) == (40, 0.1, None)


def test_another_optimiser_can_be_given() -> None:
    assert cart_pole(optimizer=torch.optim.Adam).method.optimizer is torch.optim.Adam
    assert cart_pole().method.optimizer is torch.optim.LBFGS


def test_numbers_of_numpy_are_those_of_python() -> None:
    cost = SaturatingCost(target={"q": 0.0}, width=np.float32(0.5))
    given = {"state": STATE, "num_centres": np.int64(7), "tolerance": np.float32(0.25)}
    task = own_cost(CartPoleEnv(), cost, np.int64(15), 0.1, **given)
    exact = own_cost(
        CartPoleEnv(),
        SaturatingCost(target={"q": 0.0}, width=0.5),
        15,
        0.1,
        **given | {"num_centres": 7, "tolerance": 0.25, "initial": task.initial},
    )
    assert json.dumps(task.settings) == json.dumps(exact.settings)
    assert json.dumps(task.adjustable) == json.dumps(exact.adjustable)
    assert (type(task.horizon), type(task.method.policy.num_centres)) == (int, int)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"cost": 1.0}, "a QuadraticCost or a function of states and actions, got 1.0"),
        ({"state": ()}, "state must name the entries of the observation, got none"),
        ({"state": STATE[:3]}, "state must name the 4 entries of the observation, got x, dx, q"),
        (
            {"cost": SaturatingCost(target={"tip": 0.0}, width=1.0)},
            "target must name some of x, dx, q, dq, sin q, cos q, or entries of match, got tip",
        ),
        ({"optimizer": "Adam"}, "optimizer must be a torch.optim class whose step takes a closure"),
        ({"optimizer": lambda p: None}, "got <lambda>: 'NoneType' object has no attribute 'step'"),
        ({"initial": at(0.0, 0.0, 0.0)}, "initial must be over the 4 entries of the state, got 3"),
        ({"explore_demonstrated": True}, "explore_demonstrated needs demonstrations, got a cost"),
        ({"box": {"q": 1}}, "limits of q must be two numbers, low < high, got 1"),
        ({"success": 1}, "success must be a function of states, got int"),
        (
            {"success": lambda states: states[:, -1, 0] > 1, "tolerance": 0.1},
            "tolerance must be left out beside success, which alone says what a success is",
        ),
        (
            {"success": lambda states: states[:, -1, 0] > 1, "predicted_error": torch.sum},
            "predicted_error must be left out beside success, which alone says what a",
        ),
        ({"success": lambda states: states[:, -1, 0].abs()}, "(3,), whether each motion succeeds"),
        ({"success": lambda states: states[..., 0] < 1}, "(3,), whether each motion succeeds, got"),
        ({"success": lambda states: True}, "whether each motion succeeds, got bool"),
        ({"error": of_states(lambda states: states[:, -1, 0])}, "tolerance must be given with an"),
        ({"units": ("m", "m/s", "°", "°/s")}, "angles must be in rad, got q in °: convert the"),
        ({"match": "tip"}, "match by a site needs a MujocoRobot, got CartPoleEnv"),
        ({"noise_std": 0.1}, "settings must be known ones, got 'noise_std'"),
        ({"demonstrations": None}, "settings must be known ones, got 'demonstrations'"),
        ({"steps": 30}, "settings must be known ones, got 'steps'"),
        ({"tolerence": 0.1}, "did you mean tolerance?"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(changes: dict[str, Any], said: str) -> None:
    with pytest.raises((TypeError, ValueError)) as error:
        cart_pole(**changes)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("target", "width", "said"),
    [
        ({}, 1.0, "target must say where the robot should be, as {'x': 0.0}, got {}"),
        ({"x": math.nan}, 1.0, "target of x must be a finite number, got nan"),
        ({"x": "far"}, 1.0, "target of x must be a finite number, got 'far'"),
        ({"x": 0.0}, 0.0, "cost.width must be"),
    ],
)
def test_cost_that_is_none_is_refused(target: dict[str, Any], width: float, said: str) -> None:
    with pytest.raises((TypeError, ValueError)) as error:
        SaturatingCost(target=target, width=width)
    assert said in str(error.value)
