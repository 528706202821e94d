"""The teachers that swing pendubot and acrobot up and hold them upright."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torch_pmil.envs.double_pendulum import HANGING
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv
from torch_pmil.envs.teachers.swing_up import array_dynamics
from torch_pmil.envs.teachers.trajectory_optimization import (
    QuadraticCost,
    TrackingController,
    plan_trajectory,
    tracking_controller,
)

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
    """

    steps: int
    upright_from: int
    hold_from: int
    planned_torque: float


PENDUBOT = SwingUp(steps=75, upright_from=36, hold_from=40, planned_torque=4.5)  # 3 s at 25 Hz


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
    dynamics, upright = array_dynamics(env), np.zeros(4)
    # a calm teacher: speed costs, not being away
    state_weights = np.tile([0.001, 0.02, 0.001, 0.02], (motion.steps + 1, 1))
    state_weights[motion.upright_from :] = [100.0, 10.0, 100.0, 10.0]
    cost = QuadraticCost(upright, state_weights, action_weights=np.full(1, 0.1))
    guess = np.random.default_rng(0).normal(size=(motion.steps // 5, 1)).repeat(5, axis=0)
    planned_torque = np.full(1, motion.planned_torque)
    plan = plan_trajectory(dynamics, np.array(HANGING), cost, guess, planned_torque, tolerance=1e-4)
    away = np.abs(plan.states[motion.hold_from]).max()
    if away > REACHED:
        raise RuntimeError(
            f"no swing-up found within {motion.planned_torque} N·m, the plan is {away:.2f} from "
            f"upright at step {motion.hold_from}"
        )
    weights, limit = np.array([10.0, 1.0, 10.0, 1.0]), env.torque_limits.numpy()
    return tracking_controller(
        dynamics, plan, upright, motion.hold_from, weights, np.ones(1), limit
    )
