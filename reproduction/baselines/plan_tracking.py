r"""A plan on the mean of the learned model, and the feedback that follows it.

Control-limited iterative LQR finds the actions whose states, under the mean of the model, are
nearest to the mean demonstration; a time-varying LQR with the same weights follows the plan. The
plan ignores the model's uncertainty.

Source: Y. Tassa, N. Mansard and E. Todorov (2014), Control-limited differential dynamic
programming, ICRA.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np
import torch
from torch import Tensor

from reproduction.teachers.trajectory_optimization import (
    Array,
    Dynamics,
    Plan,
    QuadraticCost,
    linearize,
    plan_trajectory,
    roll_out,
    tracking_gains,
)
from torch_pmil.checks import check_positive
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.recovered_states import without_turns
from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.tasks.task import Task

TURN = 2 * np.pi  # rad


@dataclass(frozen=True, eq=False)
class TrackedPlan:
    """A plan, and the feedback by which it is followed.

    Args:
        plan: states (T + 1, D), and actions (T, F) around the middle of their range.
        gains: of the feedback, (T, F, D).
        space, actions: of the robot.
    """

    plan: Plan
    gains: Array
    space: StateSpace
    actions: ActionSpace

    def act(self, step: int, states: Tensor) -> Tensor:
        """Actions (*batch, F), within their limits, at states (*batch, D).

        Feedback is on the distance from the planned state, of an angle without whole turns.
        """
        away = states.detach().numpy() - self.plan.states[step]
        angles = list(self.space.angles)
        away[..., angles] -= TURN * np.round(away[..., angles] / TURN)
        limit = self.actions.half_range.numpy()
        actions = self.plan.actions[step] - away @ self.gains[step].T
        return self.actions.middle + torch.from_numpy(actions.clip(-limit, limit))


@dataclass(frozen=True, eq=False)
class PlanTracking:
    r"""How a plan on the mean of a model is found.

    .. math:: \min_u \tfrac12 \sum_t (x_t - \bar x_t)^\top W_t (x_t - \bar x_t)
        + \tfrac12 \rho \sum_t \tilde u_t^\top \tilde u_t

    with W_t the inverse of the demonstrated variances plus those of the start. The actions are in
    halves of their range. They are measured from those that hold the robot there, or, if these are
    unknown, from the middle of the range.

    Args:
        space, actions: of the robot.
        start: mean of x_0, (D,).
        target: mean demonstrated states x_0..x_T, (T + 1, D).
        variance: of the states about it, (T + 1, D).
        held: actions (T, F) that hold the robot in the mean demonstrated states; None if unknown.
        action_weight: rho.
    """

    space: StateSpace
    actions: ActionSpace
    start: Tensor
    target: Tensor
    variance: Tensor
    held: Tensor | None
    action_weight: float

    @property
    def limit(self) -> Array:
        """Half the range of the actions, (F,)."""
        return self.actions.half_range.numpy()

    @property
    def effort(self) -> Array:
        """Weights (F,) of the actions around their middle."""
        return self.action_weight / self.limit**2

    @property
    def first_guess(self) -> Array:
        """Actions (T, F) around the middle of their range that hold the robot, or the middle."""
        if self.held is None:
            return np.zeros((len(self.target) - 1, len(self.actions.names)))
        return (self.held - self.actions.middle).numpy()

    def plan(self, dynamics: GPDynamics, last: Array) -> TrackedPlan:
        """The cheapest plan on the mean of a fitted model, see :meth:`plan_on`."""
        known, middle = dynamics.known_part(self.space), self.actions.middle

        @torch.no_grad()
        def successors(states: Array, actions: Array) -> Array:
            x, u = torch.from_numpy(states), middle + torch.from_numpy(actions)
            inputs = torch.cat([self.space.features(x), u], -1)
            return known.successors(x, u, dynamics.expansion.mean(inputs)).numpy()

        return self.plan_on(successors, last)

    def plan_on(self, successors: Dynamics, last: Array) -> TrackedPlan:
        """The cheapest plan that is found, and its feedback.

        It is sought from several guesses: what holds the robot, feedback towards the demonstrated
        states, and the last plan.

        Args:
            successors: next states (N, D) of states and of actions around their middle (N, F).
            last: actions (T, F) of the last plan, around their middle; without one, those of
                :attr:`first_guess`.
        """
        limit, weights, start = self.limit, (1 / self.variance).numpy(), self.start.numpy()
        cost = QuadraticCost(self.target.numpy(), weights, self.effort, self.first_guess)
        guesses = self.first_guess, self._towards_the_demonstrated(successors, weights), last
        plans = [plan_trajectory(successors, start, cost, guess, limit) for guess in guesses]
        plan = min(plans, key=attrgetter("cost"))
        return TrackedPlan(plan, self._gains(successors, plan, weights), self.space, self.actions)

    def _towards_the_demonstrated(self, successors: Dynamics, weights: Array) -> Array:
        """Actions (T, F) of feedback towards the mean demonstrated states, all the way.

        Its feedforward is what comes nearest to the next demonstrated state from the one before.
        """
        target, held = self.target.numpy(), self.first_guess
        _, B = linearize(successors, target[:-1], held)
        missed = weights[1:] * (target[1:] - successors(target[:-1], held))
        hessian = B.mT @ (weights[1:, :, None] * B) + np.diag(self.effort)
        change = np.linalg.solve(hessian, B.mT @ missed[..., None])[..., 0]
        shown = Plan(target, (held + change).clip(-self.limit, self.limit), np.inf, False)
        tracked = TrackedPlan(
            shown, self._gains(successors, shown, weights), self.space, self.actions
        )

        def act(step: int, states: Array) -> Array:
            return (tracked.act(step, torch.from_numpy(states)) - self.actions.middle).numpy()

        _, actions = roll_out(successors, self.start.numpy()[None], act, len(held))
        return actions[0]

    def _gains(self, successors: Dynamics, plan: Plan, weights: Array) -> Array:
        return tracking_gains(successors, plan, weights[:-1], self.effort, np.diag(weights[-1]))


def plan_tracking(task: Task, action_weight: float) -> PlanTracking:
    """How to plan on the mean of the model towards the mean demonstrated states of a task.

    Args:
        task: of one target.
        action_weight: weight of the actions, above 0.

    Raises:
        ValueError: the weight is not positive, or the demonstrations give no states to follow.
    """
    check_positive("action_weight", action_weight)
    count, samples = task.demonstrations.positions.shape[:2]
    several = task.demonstrations.targets is not None
    if several or len(task.demonstrated_states) != count * samples:
        raise ValueError(
            "a plan needs demonstrations of one task, and demonstrated_states of all "
            f"{count} times {samples} samples, got {len(task.demonstrated_states)} states"
            f"{' of several targets' if several else ''}"
        )
    turned = task.demonstrated_states.unflatten(0, (count, samples))
    states = without_turns(turned, task.initial.mean, task.space.angles)
    mean, held = states.mean(0), task.holding_actions
    variance = states.var(0) + task.initial.std.square()
    least = variance.amin(0).tolist()
    if still := [name for name, v in zip(task.space.names, least, strict=True) if not v > 0]:
        raise ValueError(
            "a plan needs states that vary, between demonstrations or starts, got no variance of "
            f"{', '.join(still)}"
        )
    return PlanTracking(
        task.space,
        task.actions,
        task.initial.mean,
        mean,
        variance,
        None if held is None else held(mean[:-1]),
        action_weight,
    )
