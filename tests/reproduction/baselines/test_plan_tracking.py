"""A plan on the mean of a model: optimal for a linear one, and followed within the limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from torch import Tensor

from reproduction.baselines.plan_tracking import PlanTracking, plan_tracking
from reproduction.teachers.swing_up import array_dynamics
from reproduction.teachers.trajectory_optimization import QuadraticCost, plan_trajectory
from torch_pmil.envs import CartPoleEnv
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

NAMES = ["double_pendulum", "pendubot"]


def fitted(experiment: Task) -> GPDynamics:
    """The model of an experiment, of random transitions near the start."""
    generator = torch.Generator().manual_seed(0)
    n, D, actions = 40, experiment.space.dim, experiment.actions
    states = experiment.initial.mean + torch.randn(n, D, generator=generator).double()
    share = 2 * torch.rand(n, len(actions.names), generator=generator).double() - 1
    u = actions.middle + actions.half_range * share
    dynamics = experiment.make_dynamics()
    drift = 0.1 * torch.sin(states) + 0.05 * u.sum(-1, keepdim=True)
    learned = list(dynamics.known_part(experiment.space).learned)
    dynamics.set_data(torch.cat([experiment.space.features(states), u], -1), drift[:, learned])
    return dynamics


def first_steps(tracking: PlanTracking, steps: int = 8) -> PlanTracking:
    """The beginning of the way: what a law needs, in less time."""
    held, ends = None if tracking.held is None else tracking.held[:steps], steps + 1
    target, variance = tracking.target[:ends], tracking.variance[:ends]
    return replace(tracking, target=target, variance=variance, held=held)


def successors(experiment: Task, dynamics: GPDynamics, x: Tensor, u: Tensor) -> Tensor:
    inputs = torch.cat([experiment.space.features(x), u], -1)
    with torch.no_grad():
        outputs = dynamics.expansion.mean(inputs)
    return dynamics.known_part(experiment.space).successors(x, u, outputs)


@pytest.mark.parametrize("name", NAMES)
def test_target_begins_at_the_start_whatever_turns_were_shown(name: str) -> None:
    experiment = load_experiment(name)
    start, angles = experiment.initial.mean, list(experiment.space.angles)
    shape = experiment.demonstrations.positions.shape[:2]
    turned = experiment.demonstrated_states.unflatten(0, shape).clone()
    turned[0, :, angles] += 2 * torch.pi
    changed = replace(experiment, demonstrated_states=turned.flatten(0, 1))
    tracking, plain = plan_tracking(changed, 1.0), plan_tracking(experiment, 1.0)
    away = tracking.target[0, angles] - start[angles]
    assert (away.abs() < 5 * experiment.initial.std[angles]).all()
    torch.testing.assert_close(tracking.target, plain.target)
    torch.testing.assert_close(tracking.variance, plain.variance)


@pytest.mark.parametrize("name", NAMES)
def test_plan_is_a_trajectory_of_the_mean(name: str) -> None:
    experiment = load_experiment(name)
    dynamics, tracking = fitted(experiment), first_steps(plan_tracking(experiment, 1.0))
    tracked = tracking.plan(dynamics, tracking.first_guess)
    x = torch.from_numpy(tracked.plan.states)
    u = experiment.actions.middle + torch.from_numpy(tracked.plan.actions)
    torch.testing.assert_close(x[0], experiment.initial.mean)
    following = successors(experiment, dynamics, x[:-1], u)
    torch.testing.assert_close(x[1:], following, rtol=0, atol=1e-9)
    torch.testing.assert_close(tracked.act(3, x[3][None])[0], u[3])
    again = tracking.plan(dynamics, tracked.plan.actions)  # goes on where that is cheaper
    assert again.plan.cost <= tracked.plan.cost * (1 + 1e-9)


def test_plan_costs_no_more_than_what_a_general_minimiser_finds() -> None:
    experiment = load_experiment("double_pendulum")
    dynamics, tracking = fitted(experiment), first_steps(plan_tracking(experiment, 10.0), 3)
    limit = experiment.actions.half_range

    def cost(flat: np.ndarray) -> float:
        u, x, total = torch.from_numpy(flat).reshape(3, 2), experiment.initial.mean, 0.0
        for step in range(3):
            total += 5.0 * (u[step] / limit).square().sum().item()
            x = successors(experiment, dynamics, x[None], u[step][None])[0]
            away = (x - tracking.target[step + 1]).square() / tracking.variance[step + 1]
            total += 0.5 * away.sum().item()
        return total

    first = 0.5 * ((experiment.initial.mean - tracking.target[0]) ** 2 / tracking.variance[0]).sum()
    best = minimize(cost, np.zeros(6), bounds=[(-limit[0].item(), limit[0].item())] * 6)
    plan = tracking.plan(dynamics, tracking.first_guess).plan
    assert plan.cost - first.item() == pytest.approx(cost(plan.actions.flatten()), rel=1e-9)
    assert plan.cost - first.item() <= best.fun * (1 + 1e-3)


def test_swing_up_is_found_though_no_actions_are_a_bad_guess() -> None:
    """On the robot itself; from no actions alone iterative LQR leaves the pole hanging."""
    experiment = load_experiment("cart_pole")
    tracking, robot = plan_tracking(experiment, 1.0), array_dynamics(CartPoleEnv())
    plan = tracking.plan_on(robot, tracking.first_guess).plan
    assert np.abs(plan.states[-1] - tracking.target[-1].numpy()).max() < 0.2
    weights, still = (1 / tracking.variance).numpy(), tracking.first_guess
    cost = QuadraticCost(tracking.target.numpy(), weights, tracking.effort, still)
    alone = plan_trajectory(robot, tracking.start.numpy(), cost, still, tracking.limit)
    assert plan.cost < alone.cost / 10


def test_feedback_stays_within_limits_and_takes_no_notice_of_whole_turns() -> None:
    experiment = load_experiment("double_pendulum")
    tracking = first_steps(plan_tracking(experiment, 1.0))
    tracked = tracking.plan(fitted(experiment), tracking.first_guess)
    state = torch.from_numpy(tracked.plan.states[3]) + 0.01
    turned = state + 2 * torch.pi * torch.tensor([1.0, 0.0, -1.0, 0.0]).double()
    torch.testing.assert_close(tracked.act(3, turned[None]), tracked.act(3, state[None]))
    far = tracked.act(3, state + 1e6 * torch.eye(4).double())
    assert (far <= experiment.actions.high + 1e-12).all()
    assert (far >= experiment.actions.low - 1e-12).all()


def test_costly_actions_are_those_that_hold() -> None:
    experiment = load_experiment("double_pendulum_servo")
    dynamics, away = fitted(experiment), []
    for weight in (0.1, 1e10):
        tracking = first_steps(plan_tracking(experiment, weight))
        tracked = tracking.plan(dynamics, tracking.first_guess)
        away.append(np.abs(tracked.plan.actions - tracking.first_guess).max())
    assert away[1] < 1e-3 < away[0]
