"""The teachers that demonstrate the two tasks of gymnasium."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from reproduction.teachers.trajectory_optimization import (
    Array,
    QuadraticCost,
    TrackingController,
    linear_regulator,
    plan_trajectory,
    tracking_controller,
)
from torch_pmil.envs.gym_tasks import HANGING_MEAN, cart_dynamics, pendulum_dynamics

CART_STEPS = 50  # 2 s at 25 Hz
CART_LIMIT = 3.0
PENDULUM_STEPS = 40  # 4 s at 10 Hz
UPRIGHT_FROM = 32  # the plan is paid for being upright from 3.2 s
HOLD_FROM = 35  # the last 0.5 s balance
TORQUE_LIMIT = np.array([2.0])  # N·m
PLANNED_TORQUE = np.array([1.6])  # N·m; the rest up to the limit is for feedback


def balancing_teacher() -> Callable[[int, Array], Array]:
    """Infinite-horizon LQR about upright at the middle of the rail.

    It is a function of step and states (N, 4) that returns actions (N, 1).
    """
    state_weights, action_weights = np.array([10.0, 1.0, 0.1, 0.1]), np.array([0.1])
    gain, _ = linear_regulator(cart_dynamics(), np.zeros(4), state_weights, action_weights)
    return lambda step, states: (-states @ gain.T).clip(-CART_LIMIT, CART_LIMIT)


def pendulum_teacher() -> TrackingController:
    """A planned swing-up of Pendulum-v1, tracked by feedback, then held.

    It is a function of step (0..39) and states (N, 2) that returns torques (N, 1) in N·m.

    Raises:
        RuntimeError: the plan does not reach the upright position within the torque limit.
    """
    dynamics, start, upright = pendulum_dynamics(), np.array(HANGING_MEAN), np.zeros(2)
    # a calm teacher: speed costs, not being away
    state_weights = np.tile([0.001, 0.01], (PENDULUM_STEPS + 1, 1))
    state_weights[UPRIGHT_FROM:] = [100.0, 10.0]
    cost = QuadraticCost(upright, state_weights, action_weights=np.array([0.5]))
    guess = np.random.default_rng(0).normal(size=(PENDULUM_STEPS // 5, 1)).repeat(5, axis=0)
    plan = plan_trajectory(dynamics, start, cost, guess, PLANNED_TORQUE)
    if np.abs(plan.states[HOLD_FROM]).max() > 0.1:
        raise RuntimeError(
            f"no swing-up found within {PLANNED_TORQUE[0]} N·m, the plan is at "
            f"{plan.states[HOLD_FROM]} before it holds"
        )
    weights = np.array([10.0, 1.0])
    return tracking_controller(
        dynamics, plan, upright, HOLD_FROM, weights, np.ones(1), TORQUE_LIMIT
    )
