"""Base class of expected costs, which need no demonstrations."""

from __future__ import annotations

from typing import Unpack

from torch import Tensor

from torch_pmil.checks import check_whole
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.trajectory_loss import LossOptions, TrajectoryLoss


class ExpectedCost(TrajectoryLoss):
    """Base class of expected costs, summed over a horizon: ``"loss_cost"``.

    Args:
        actor_network, dynamics, space, options: as in :class:`TrajectoryLoss`.
        horizon: T, number of steps after the start.

    Raises:
        ValueError: the horizon is not a whole number of at least 1, or the reduction is unknown.
    """

    out_keys = ["loss_cost"]
    label, unit = "cost", ""

    def __init__(
        self,
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
        space: StateSpace,
        horizon: int,
        **options: Unpack[LossOptions],
    ) -> None:
        super().__init__(actor_network, dynamics, space, **options)
        check_whole("horizon", horizon, 1)
        self._horizon = horizon

    @property
    def horizon(self) -> int:
        """T, number of steps after the start."""
        return self._horizon

    def step_loss_for_trust(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """How unsure each predicted marginal is (:meth:`TrajectoryLoss.spread`), (*batch, horizon).

        A cost is high far from the goal, however sure the prediction is.
        """
        return self.spread(initial, horizon)

    def trusts_start(self, initial: Gaussian, threshold: float) -> bool:
        """Whether the start is as sure as a step that is trusted.

        A cost says nothing of a prediction that is wide from the first step on, such as that of a
        pendulum which begins at any angle.
        """
        return self._spread_of(self.begin(initial)[0]).amax().item() <= threshold

    def typical_cost(self, states: Tensor) -> Tensor:
        r"""Cost that one state may change, by trajectories x_0..x_T, (N, \*batch, T + 1, D).

        That of a whole motion: the way to the goal pays only once the robot has arrived.
        """
        return self.horizon * super().typical_cost(states)
