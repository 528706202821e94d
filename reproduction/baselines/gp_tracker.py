"""A tracker of the mean demonstration on our own model: iterative LQR, then time-varying LQR."""

from __future__ import annotations

from operator import attrgetter

import numpy as np
import torch
from torch import Tensor

from reproduction.baselines.model_peer import ModelPeer
from torch_pmil.control.recovered_states import without_turns
from torch_pmil.envs.robot import Array
from torch_pmil.envs.teachers.trajectory_optimization import (
    QuadraticCost,
    plan_trajectory,
    tracking_gains,
)
from torch_pmil.experiments.tasks.experiment import Experiment

TURN = 2 * np.pi  # rad


class GPTracker(ModelPeer):
    r"""Plans on the mean of our Gaussian process, and follows the plan by linear feedback.

    The model learns from all transitions as ours does. Control-limited iterative LQR finds the
    actions whose states, under the mean of the model, are nearest to the mean demonstration:

    .. math:: \tfrac12 \sum_t (x_t - \bar x_t)^\top W_t (x_t - \bar x_t)
        + \tfrac12 \rho\, \tilde u_t^\top \tilde u_t

    with W_t the inverse of the demonstrated variances plus those of the start, and the actions told
    from those that hold the robot there, if they are known, in halves of their range. A
    time-varying LQR with the same weights follows the plan. What the model does not know is not
    seen: that is what our own objective adds.

    Args:
        experiment, seed: as of :class:`ModelPeer`.
        action_weight: rho.

    Source: Y. Tassa, N. Mansard and E. Todorov (2014), Control-limited differential dynamic
    programming, ICRA.
    """

    label, name = "GP + iLQR, TVLQR", "gp_tracker"

    def __init__(self, experiment: Experiment, seed: int, action_weight: float = 0.1) -> None:
        super().__init__(experiment, seed)
        actions = experiment.actions
        self._middle, self._limit = actions.middle.numpy(), actions.half_range.numpy()
        positions = experiment.demonstrations.positions
        turned = experiment.demonstrated_states.unflatten(0, positions.shape[:2])
        states = without_turns(turned, experiment.initial.mean, experiment.space.angles)
        mean, weights = states.mean(0), 1 / (states.var(0) + experiment.initial.std.square())
        self._action_weights = action_weight / self._limit**2
        self._first_guess: Array = np.zeros((experiment.horizon, len(self._limit)))
        if experiment.holding_actions is not None:
            self._first_guess = experiment.holding_actions(mean[:-1]).numpy() - self._middle
        self._guesses: tuple[Array, ...] = (self._first_guess,)
        self._cost = QuadraticCost(
            mean.numpy(), weights.numpy(), self._action_weights, self._first_guess
        )

    def fit(self) -> None:
        """Fit the model to all transitions, plan on it, and find gains about the plan."""
        self.fit_model()
        self._known = self.dynamics.known_part(self.experiment.space)
        start = self.experiment.initial.mean.numpy()
        plans = [
            plan_trajectory(self._next, start, self._cost, guess, self._limit)
            for guess in self._guesses
        ]
        self._plan = min(plans, key=attrgetter("cost"))
        weights, self._guesses = self._cost.state_weights, (self._first_guess, self._plan.actions)
        self._gains = tracking_gains(
            self._next, self._plan, weights[:-1], self._action_weights, np.diag(weights[-1])
        )

    def act(self, step: int, states: Tensor) -> Tensor:
        """The planned action, and feedback on the distance from the planned state."""
        away = states.numpy() - self._plan.states[step]
        angles = list(self.experiment.space.angles)
        away[..., angles] -= TURN * np.round(away[..., angles] / TURN)
        actions = self._plan.actions[step] - away @ self._gains[step].T
        return torch.from_numpy(self._middle + actions.clip(-self._limit, self._limit))

    @torch.no_grad()
    def _next(self, states: Array, actions: Array) -> Array:
        """Next states (N, D) by the mean of the model; actions (N, F) are around their middle."""
        x, u = torch.from_numpy(states), torch.from_numpy(self._middle + actions)
        inputs = torch.cat([self.experiment.space.features(x), u], -1)
        return self._known.successors(x, u, self.dynamics.expansion.mean(inputs)).numpy()
