r"""A plan on the mean of the learned model, and a policy that follows it: a start of a search.

Control-limited iterative LQR finds the actions whose states, under the mean of the model, are
nearest to the mean demonstration; a time-varying LQR with the same weights follows the plan. What
the model does not know is not seen: that is what the search adds, which starts from it.

Source: Y. Tassa, N. Mansard and E. Todorov (2014), Control-limited differential dynamic
programming, ICRA.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
import torch
from torch import Tensor

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.teachers.trajectory_optimization import (
    Array,
    Plan,
    QuadraticCost,
    plan_trajectory,
    tracking_gains,
)
from torch_pmil.gp.gaussian import normal
from torch_pmil.model.dynamics import GPDynamics

TURN = 2 * np.pi  # rad
SAMPLES = 20  # states a time step, at which a policy is fitted


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

    with W_t the inverse of the demonstrated variances plus those of the start, and the actions told
    from those that hold the robot there, if they are known, or from the middle of their range, in
    halves of their range.

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
    def first_guess(self) -> Array:
        """Actions (T, F) around the middle of their range that hold the robot, or the middle."""
        if self.held is None:
            return np.zeros((len(self.target) - 1, len(self.actions.names)))
        return (self.held - self.actions.middle).numpy()

    def plan(self, dynamics: GPDynamics, guesses: Sequence[Array]) -> TrackedPlan:
        """The cheapest plan on the mean of a fitted model, and its feedback.

        Args:
            dynamics: the model.
            guesses: actions (T, F) around the middle of their range, to plan from.
        """
        known, middle = dynamics.known_part(self.space), self.actions.middle

        @torch.no_grad()
        def successors(states: Array, actions: Array) -> Array:
            x, u = torch.from_numpy(states), middle + torch.from_numpy(actions)
            inputs = torch.cat([self.space.features(x), u], -1)
            return known.successors(x, u, dynamics.expansion.mean(inputs)).numpy()

        limit, weights = self.actions.half_range.numpy(), (1 / self.variance).numpy()
        effort = self.action_weight / limit**2
        cost = QuadraticCost(self.target.numpy(), weights, effort, self.first_guess)
        start = self.start.numpy()
        plans = [plan_trajectory(successors, start, cost, guess, limit) for guess in guesses]
        plan = min(plans, key=attrgetter("cost"))
        gains = tracking_gains(successors, plan, weights[:-1], effort, np.diag(weights[-1]))
        return TrackedPlan(plan, gains, self.space, self.actions)

    def fit_policy(
        self, policy: RBFPolicy, tracked: TrackedPlan, generator: torch.Generator
    ) -> None:
        """Fit a policy's weights to the actions of a tracked plan, at states near the plan."""
        std = self.variance.sqrt()
        states, actions = [], []
        for step, planned in enumerate(torch.from_numpy(tracked.plan.states[:-1])):
            white = normal((SAMPLES, len(planned)), planned, generator)
            states.append(planned + std[step] * white)
            actions.append(tracked.act(step, states[-1]))
        policy.fit_weights(self.space.features(torch.cat(states)), torch.cat(actions))
