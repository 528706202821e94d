"""The teachers that swing pendubot, acrobot and cart-pole up and hold them upright."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reproduction.teachers.swing_up import array_dynamics
from reproduction.teachers.trajectory_optimization import (
    Array,
    Dynamics,
    QuadraticCost,
    TrackingController,
    plan_trajectory,
    roll_out,
    tracking_controller,
)
from torch_pmil.envs.double_pendulum import HANGING
from torch_pmil.envs.mujoco import MujocoRobotEnv

STEPS = 75  # 3 s at 25 Hz
CART_STEPS = 30  # 3 s at 10 Hz
# of the acrobot's guess, found by a random search: bend of the elbow in rad, N·m/rad, N·m·s/rad
BEND, STIFFNESS, DAMPING = 1.55, 4.1347, 0.1588
KICK, KICK_STEPS = 3.0, 3  # N·m at its begin
SWING_STEPS, SWING_LIMIT = 44, 5.0  # N·m
REACHED = 0.1  # of any entry of the state, largest distance of the plan from upright when held


@dataclass(frozen=True)
class SwingUp:
    """How a teacher swings a robot up.

    Args:
        steps: control steps of the motion.
        upright_from: step from which the plan is paid for being upright.
        hold_from: step from which a fixed feedback holds it there.
        planned_action: largest absolute action of the plan, N·m or N; the rest up to the limit is
            for feedback.
        guess: actions to plan from, (steps, 1), of the robot's dynamics.
        upright: state to reach, of whole turns.
        weights: of being upright in the plans, each of which is the guess of the next; the last
            is 1.
        moving_weights: of the state's entries before it is upright.
    """

    steps: int
    upright_from: int
    hold_from: int
    planned_action: float
    guess: Callable[[Dynamics], Array]
    upright: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    weights: tuple[float, ...] = (1.0,)
    # a calm teacher: speed costs, not being away
    moving_weights: tuple[float, ...] = (0.001, 0.02, 0.001, 0.02)


def random_torques(dynamics: Dynamics) -> Array:
    """Random torques (75, 1), N·m, held for five steps each, whatever the robot."""
    return np.random.default_rng(0).normal(size=(STEPS // 5, 1)).repeat(5, axis=0)


def swinging_torques(dynamics: Dynamics) -> Array:
    """Torques (75, 1) of an elbow that bends against the swing of link 1, N·m.

    The bend feeds the swing, until both links are nearly upright; then there are none.
    """

    def bend(step: int, states: Array) -> Array:
        if step < KICK_STEPS:
            return np.full((len(states), 1), KICK)
        bent = -BEND * 2 / math.pi * np.arctan(states[:, 1])
        torque = STIFFNESS * (bent - states[:, 2]) - DAMPING * states[:, 3]
        return torque.clip(-SWING_LIMIT, SWING_LIMIT)[:, None]

    _, torques = roll_out(dynamics, np.array([HANGING]), bend, SWING_STEPS)
    return np.concatenate([torques[0], np.zeros((STEPS - SWING_STEPS, 1))])


def pushes(dynamics: Dynamics) -> Array:
    """Forces (30, 1), N, that push a cart to and fro, as a hanging pole gains by."""
    return np.repeat([5.0, -5.0, 5.0, 0.0], [4, 6, 4, 16])[:, None]


PENDUBOT = SwingUp(
    steps=STEPS, upright_from=36, hold_from=40, planned_action=4.5, guess=random_torques
)
ACROBOT = SwingUp(
    steps=STEPS,
    upright_from=48,
    hold_from=54,
    planned_action=5.0,
    guess=swinging_torques,
    upright=(0.0, 0.0, 2 * math.pi, 0.0),  # link 2 turns round once
    weights=(0.003, 0.1, 1.0),
)
CART_POLE = SwingUp(
    steps=CART_STEPS,
    upright_from=20,
    hold_from=23,
    planned_action=6.0,
    guess=pushes,
    weights=(0.1, 1.0),
    moving_weights=(0.05, 0.02, 0.001, 0.02),  # not far from where the cart is to stand
)


def one_motor_teacher(env: MujocoRobotEnv, motion: SwingUp) -> TrackingController:
    """Plan the swing-up from the mean start, and a controller that follows it, then balances.

    Args:
        env: one robot with two joints and one motor; its limit is that of plan and feedback
            together.
        motion: times and largest action of the plan.

    Returns:
        The controller, a function of step and states (N, 4) that returns actions (N, 1), N·m or N.

    Raises:
        RuntimeError: the plan does not reach the upright position within the planned action.
    """
    dynamics, upright = array_dynamics(env), np.array(motion.upright)
    actions, planned_action = motion.guess(dynamics), np.full(1, motion.planned_action)
    for weight in motion.weights:
        state_weights = np.tile(motion.moving_weights, (motion.steps + 1, 1))
        state_weights[motion.upright_from :] = weight * np.array([100.0, 10.0, 100.0, 10.0])
        cost = QuadraticCost(upright, state_weights, action_weights=np.full(1, 0.1))
        start = env.initial_mean.numpy()
        plan = plan_trajectory(dynamics, start, cost, actions, planned_action, tolerance=1e-4)
        actions = plan.actions
    away = np.abs(plan.states[motion.hold_from] - upright).max()
    if away > REACHED:
        raise RuntimeError(
            f"no swing-up found within {motion.planned_action} {env.action_units[0]}, the plan is "
            f"{away:.2f} from upright at step {motion.hold_from}"
        )
    weights, limit = np.array([10.0, 1.0, 10.0, 1.0]), env.torque_limits.numpy()
    return tracking_controller(
        dynamics, plan, upright, motion.hold_from, weights, np.ones(1), limit
    )
