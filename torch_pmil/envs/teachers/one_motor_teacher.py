"""The teachers that swing pendubot and acrobot up and hold them upright."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from torch_pmil.envs.double_pendulum import HANGING
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv
from torch_pmil.envs.teachers.swing_up import array_dynamics
from torch_pmil.envs.teachers.trajectory_optimization import (
    Array,
    Dynamics,
    QuadraticCost,
    TrackingController,
    plan_trajectory,
    roll_out,
    tracking_controller,
)

STEPS = 75  # 3 s at 25 Hz
# of the acrobot's guess, found by a random search: bend of the elbow in rad, N·m/rad, N·m·s/rad
BEND, STIFFNESS, DAMPING = 1.55, 4.1347, 0.1588
KICK, KICK_STEPS = 3.0, 3  # N·m at its begin
SWING_STEPS, SWING_LIMIT = 44, 5.0  # N·m
REACHED = 0.1  # rad and rad/s, largest distance of the plan from upright where it is held


@dataclass(frozen=True)
class SwingUp:
    """How a teacher swings a robot up.

    Args:
        steps: control steps of the motion.
        upright_from: step from which the plan is paid for being upright.
        hold_from: step from which a fixed feedback holds it there.
        planned_torque: largest absolute torque of the plan, N·m; the rest up to the limit is for
            feedback.
        guess: torques to plan from, (steps, 1), N·m, of the robot's dynamics.
        upright: state to reach, of whole turns.
        weights: of being upright in the plans, each of which is the guess of the next; the last
            is 1.
    """

    steps: int
    upright_from: int
    hold_from: int
    planned_torque: float
    guess: Callable[[Dynamics], Array]
    upright: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    weights: tuple[float, ...] = (1.0,)


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


PENDUBOT = SwingUp(
    steps=STEPS, upright_from=36, hold_from=40, planned_torque=4.5, guess=random_torques
)
ACROBOT = SwingUp(
    steps=STEPS,
    upright_from=48,
    hold_from=54,
    planned_torque=5.0,
    guess=swinging_torques,
    upright=(0.0, 0.0, 2 * math.pi, 0.0),  # link 2 turns round once
    weights=(0.003, 0.1, 1.0),
)


def one_motor_teacher(env: PendubotEnv | AcrobotEnv, motion: SwingUp) -> TrackingController:
    """Plan the swing-up from hanging, and a controller that follows the plan, then balances.

    Args:
        env: one robot; its torque limit is that of plan and feedback together.
        motion: times and torque of the plan.

    Returns:
        The controller, a function of step and states (N, 4) that returns torques (N, 1) in N·m.

    Raises:
        RuntimeError: the plan does not reach the upright position within the planned torque.
    """
    dynamics, upright = array_dynamics(env), np.array(motion.upright)
    actions, planned_torque = motion.guess(dynamics), np.full(1, motion.planned_torque)
    for weight in motion.weights:
        # a calm teacher: speed costs, not being away
        state_weights = np.tile([0.001, 0.02, 0.001, 0.02], (motion.steps + 1, 1))
        state_weights[motion.upright_from :] = weight * np.array([100.0, 10.0, 100.0, 10.0])
        cost = QuadraticCost(upright, state_weights, action_weights=np.full(1, 0.1))
        start = np.array(HANGING)
        plan = plan_trajectory(dynamics, start, cost, actions, planned_torque, tolerance=1e-4)
        actions = plan.actions
    away = np.abs(plan.states[motion.hold_from] - upright).max()
    if away > REACHED:
        raise RuntimeError(
            f"no swing-up found within {motion.planned_torque} N·m, the plan is {away:.2f} from "
            f"upright at step {motion.hold_from}"
        )
    weights, limit = np.array([10.0, 1.0, 10.0, 1.0]), env.torque_limits.numpy()
    return tracking_controller(
        dynamics, plan, upright, motion.hold_from, weights, np.ones(1), limit
    )
