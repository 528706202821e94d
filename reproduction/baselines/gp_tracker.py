"""A tracker of the mean demonstration on our own model: iterative LQR, then time-varying LQR."""

from __future__ import annotations

from torch import Tensor

from reproduction.baselines.model_peer import ModelPeer
from reproduction.baselines.plan_tracking import plan_tracking
from torch_pmil.tasks.task import Task


class GPTracker(ModelPeer):
    """Plans on the mean of our Gaussian process, and follows the plan by linear feedback.

    The model learns from all transitions as ours does. The plan is sought from the last one on, and
    anew (:func:`~reproduction.baselines.plan_tracking.plan_tracking`). It ignores the model's
    uncertainty, which our own objective accounts for.

    Args:
        experiment, seed: as for :class:`Peer`.
        action_weight: of the plan.
    """

    label, name = "GP + iLQR, TVLQR", "gp_tracker"

    def __init__(self, experiment: Task, seed: int, action_weight: float = 1.0) -> None:
        super().__init__(experiment, seed)
        self.tracking = plan_tracking(experiment, action_weight)
        self._last = self.tracking.first_guess

    def fit(self) -> None:
        """Fit the model to all transitions, plan on it, and find gains about the plan."""
        self.fit_model()
        self.tracked = self.tracking.plan(self.dynamics, self._last)
        self._last = self.tracked.plan.actions

    def act(self, step: int, states: Tensor) -> Tensor:
        """The planned action, and feedback on the distance from the planned state."""
        return self.tracked.act(step, states)
