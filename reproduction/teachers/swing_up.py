"""The teacher that swings the double pendulum up, or to another pose, and holds it (Sec. 5.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from reproduction.teachers.trajectory_optimization import (
    Array,
    Dynamics,
    QuadraticCost,
    TrackingController,
    plan_trajectory,
    roll_out,
    tracking_controller,
)
from torch_pmil.envs.double_pendulum import LINK_LENGTH, double_pendulum_model
from torch_pmil.envs.mujoco import MujocoRobotEnv

STEPS = 25  # 2.5 s at 10 Hz, paper
UPRIGHT_FROM = 18  # the plan is paid for being upright from 1.8 s
HOLD_FROM = 20  # the last 0.5 s hold it
HANGING = np.array([math.pi, 0.0, 0.0, 0.0])
UPRIGHT = np.zeros(4)  # q1 and q2 end where no link has wound up
TORQUE_LIMIT = 3.5  # N·m, of plan and feedback together
PLANNED_TORQUE = 3.0  # N·m; the rest up to the limit is for feedback
TORQUE_NOISE = 0.1  # N·m, standard deviation of the demonstrator's imprecision at each step
PLANNING_TIMESTEP = 0.01  # s; five times the simulation's, exact enough to plan with


def swing_up_teacher(
    link_masses: Sequence[float] = (0.5, 0.5),
    link_lengths: Sequence[float] = (LINK_LENGTH, LINK_LENGTH),
) -> TrackingController:
    """Plan the swing-up from hanging and a controller that follows the plan, then balances.

    Args:
        link_masses: masses of the two rods in kg.
        link_lengths: of the rods in m.

    Returns:
        The controller, a function of step (0..24) and states (N, 4) that returns torques (N, 2) in
        N·m.

    Raises:
        RuntimeError: the plan does not reach the upright position within the torque limit.
    """
    guess = np.random.default_rng(0).normal(size=(5, 2)).repeat(5, axis=0)
    # a calm teacher: speed costs, not being away
    state_weights = np.tile([0.001, 0.05, 0.001, 0.05], (STEPS + 1, 1))
    state_weights[UPRIGHT_FROM:] = [100.0, 10.0, 100.0, 10.0]
    cost = QuadraticCost(UPRIGHT, state_weights, action_weights=np.full(2, 0.2))
    return teacher_for(cost, guess, link_masses, link_lengths)


def teacher_for(
    cost: QuadraticCost,
    guess: Array,
    link_masses: Sequence[float] = (0.5, 0.5),
    link_lengths: Sequence[float] = (LINK_LENGTH, LINK_LENGTH),
) -> TrackingController:
    """Plan the motion from hanging to a pose, and a controller that tracks it and holds there.

    Args:
        cost: of the motion; its target is the pose at rest, its ``hold_action`` the torques (2,)
            that keep it, in N·m.
        guess: torques to plan from, (25, 2), in N·m.
        link_masses: masses of the two rods in kg.
        link_lengths: of the rods in m.

    Raises:
        RuntimeError: the plan does not reach the pose within the torque limit.
    """
    dynamics = planning_dynamics(link_masses, link_lengths)
    plan = plan_trajectory(dynamics, HANGING, cost, guess, np.full(2, PLANNED_TORQUE))
    if np.abs(plan.states[HOLD_FROM] - cost.target).max() > 0.1:
        raise RuntimeError(
            f"no plan found within {PLANNED_TORQUE} N·m for link masses {link_masses} kg to the "
            f"state {cost.target.tolist()}"
        )
    return tracking_controller(
        dynamics,
        plan,
        target=cost.target,
        hold_from=HOLD_FROM,
        state_weights=np.array([10.0, 1.0, 10.0, 1.0]),
        action_weights=np.ones(2),
        action_limit=np.full(2, TORQUE_LIMIT),
        hold_action=cost.hold_action,
    )


def demonstrate(
    env: MujocoRobotEnv,
    teacher: Callable[[int, Array], Array],
    seed: int,
    torque_noise: float = TORQUE_NOISE,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Let a teacher move N double pendulums at once, with noise on its torques.

    Args:
        env: the N robots, which draw the starts.
        teacher: torques (N, 2) in N·m of step (0..24) and states (N, 4), such as
            :func:`swing_up_teacher`.
        seed: of the noise.
        torque_noise: standard deviation of what is added to the torques, drawn anew at each step,
            in N·m.

    Returns:
        States x_0..x_T, (N, T + 1, 4), and the torques that were applied, (N, T, 2), in N·m.
    """
    noise = np.random.default_rng(seed).normal(size=(STEPS, *env.batch_size, 2))
    limit = env.action_spec.space.high.numpy()

    def imprecise_teacher(step: int, states: Array) -> Array:
        return (teacher(step, states) + torque_noise * noise[step]).clip(-limit, limit)

    starts = env.reset()["observation"].numpy()
    states, torques = roll_out(array_dynamics(env), starts, imprecise_teacher, STEPS)
    return torch.from_numpy(states), torch.from_numpy(torques)


def planning_dynamics(
    link_masses: Sequence[float] = (0.5, 0.5),
    link_lengths: Sequence[float] = (LINK_LENGTH, LINK_LENGTH),
) -> Dynamics:
    """The double pendulum at a coarser simulation step, as a function of arrays."""
    model = double_pendulum_model(link_masses, link_lengths)
    model.opt.timestep = PLANNING_TIMESTEP
    env = MujocoRobotEnv(
        model,
        ("q1", "q2"),
        initial_mean=HANGING.tolist(),
        initial_std=(0.0,) * 4,
        torque_limit=TORQUE_LIMIT,
        seed=0,
    )
    return array_dynamics(env)


def array_dynamics(env: MujocoRobotEnv) -> Dynamics:
    """One control period of an environment as a function of arrays.

    It takes states (N, D) and actions (N, F) to states (N, D).
    """

    def dynamics(states: Array, actions: Array) -> Array:
        return env.simulate(torch.tensor(states), torch.tensor(actions)).numpy()

    return dynamics
