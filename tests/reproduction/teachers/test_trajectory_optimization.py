"""Trajectory optimisation on linear systems, where the answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from reproduction.teachers.trajectory_optimization import (
    QuadraticCost,
    linearize,
    plan_trajectory,
    roll_out,
    tracking_controller,
    tracking_gains,
)

A = np.array([[1.0, 0.1], [0.2, 1.05]])
B = np.array([[0.0], [0.1]])
START, TARGET, STEPS = np.array([1.0, 0.0]), np.zeros(2), 15
NO_ACTIONS = np.zeros((STEPS, 1))
COST = QuadraticCost(TARGET, np.tile([1.0, 0.1], (STEPS + 1, 1)), np.array([0.05]))


def linear_dynamics(states, actions):
    return states @ A.T + actions @ B.T


def planned(start, cost, limit, tolerance=1e-12, actions=NO_ACTIONS):
    return plan_trajectory(
        linear_dynamics, start, cost, actions, np.array([limit]), tolerance=tolerance
    )


def pendulum(states, actions):
    angle, velocity = states.T
    faster = velocity + 0.1 * (np.sin(angle) + actions[:, 0])
    return np.stack([angle + 0.1 * faster, faster], axis=1)


def cost_of_actions(actions, cost):
    states = roll_out(linear_dynamics, START[None], lambda t, _: actions[None, t : t + 1], STEPS)[0]
    return cost(states[0], actions[:, None])


@pytest.mark.parametrize("hold_action", [0.0, 1.5])
@pytest.mark.parametrize("limit", [100.0, 2.0])
def test_plan_for_a_linear_system_is_the_optimum_within_the_limits(limit, hold_action):
    cost, bounds = replace(COST, hold_action=np.array([hold_action])), [(-limit, limit)] * STEPS
    plan = planned(START, cost, limit)
    given, options = (cost_of_actions, np.zeros(STEPS), (cost,)), {"ftol": 1e-15}
    optimum = minimize(*given, method="L-BFGS-B", bounds=bounds, options=options)
    assert plan.converged
    assert plan.cost == pytest.approx(optimum.fun, rel=1e-8)
    np.testing.assert_allclose(plan.actions[:, 0], optimum.x, atol=1e-2)
    assert np.abs(plan.actions).max() <= limit
    # at an optimum rounding alone decides whether a step lowers the cost
    again = planned(START, cost, limit, actions=plan.actions)
    assert again.converged
    np.testing.assert_allclose(again.actions, plan.actions, rtol=0, atol=1e-7)


def test_derivatives_of_a_pendulum():
    states = np.array([[0.3, 0.1], [2.0, -1.0]])
    by_state, by_action = linearize(pendulum, states, np.zeros((2, 1)))
    slope = 0.1 * np.cos(states[:, 0])
    expected = np.array([[[1 + 0.1 * s, 0.1], [s, 1]] for s in slope])
    np.testing.assert_allclose(by_state, expected, atol=1e-9)
    np.testing.assert_allclose(by_action, np.tile([[0.01], [0.1]], (2, 1, 1)), atol=1e-9)


def test_controller_keeps_disturbed_starts_on_the_plan_and_at_the_target():
    limit = np.array([3.0])
    weights = np.tile([0.1, 0.01], (31, 1))
    weights[20:] = [100.0, 10.0]
    cost = QuadraticCost(TARGET, weights, np.array([0.1]))
    plan = plan_trajectory(pendulum, np.array([np.pi, 0.0]), cost, np.full((30, 1), 1.0), limit)
    controller = tracking_controller(
        pendulum, plan, TARGET, 24, np.array([10.0, 1.0]), np.ones(1), limit
    )
    starts = np.array([np.pi, 0.0]) + np.random.default_rng(0).normal(scale=0.05, size=(10, 2))
    states, actions = roll_out(pendulum, starts, controller, 30)
    assert np.abs(states[:, -1]).max() < 0.05
    assert np.abs(actions).max() <= 3.0


def test_controller_holds_a_target_where_the_robot_does_not_rest_by_itself():
    limit, leaning, hold = np.array([3.0]), np.array([0.6, 0.0]), np.array([-np.sin(0.6)])
    cost = QuadraticCost(leaning, np.tile([10.0, 1.0], (31, 1)), np.array([0.1]), hold)
    plan = plan_trajectory(pendulum, np.zeros(2), cost, np.zeros((30, 1)), limit)
    controller = tracking_controller(
        pendulum, plan, leaning, 24, np.array([10.0, 1.0]), np.ones(1), limit, hold
    )
    np.testing.assert_allclose(controller(24, leaning[None]), hold[None], rtol=0, atol=1e-12)
    starts = np.random.default_rng(0).normal(scale=0.05, size=(10, 2))
    states, _ = roll_out(pendulum, starts, controller, 60)
    np.testing.assert_allclose(states[:, -1], np.tile(leaning, (10, 1)), rtol=0, atol=1e-3)


def test_gains_about_a_plan_are_those_of_the_optimum() -> None:
    """What the cheapest way from elsewhere does differs by the gains, step by step."""
    weights, last = COST.state_weights[:-1], np.diag(COST.state_weights[-1])
    starts = START, START + np.array([0.2, -0.5])
    plan, other = (planned(start, COST, 1e3, tolerance=1e-14) for start in starts)
    gains = tracking_gains(linear_dynamics, plan, weights, COST.action_weights, last)
    away = np.einsum("tfd,td->tf", gains, (other.states - plan.states)[:-1])
    np.testing.assert_allclose(other.actions, plan.actions - away, atol=1e-4)
    assert gains.shape == (STEPS, 1, 2)


def test_plan_follows_states_that_change() -> None:
    reference = roll_out(linear_dynamics, START[None], lambda t, _: np.array([[np.sin(t)]]), STEPS)
    cost = replace(COST, target=reference[0][0], action_weights=np.array([1e-9]))
    plan = planned(START, cost, 10.0)
    np.testing.assert_allclose(plan.actions, reference[1][0], atol=1e-3)
