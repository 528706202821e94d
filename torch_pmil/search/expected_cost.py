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
        """Whether the spread of the start is within the threshold up to which a step is trusted.

        The expected cost of a prediction that is wide from the first step on guides no search, as
        for a pendulum that begins at any angle.
        """
        return self._spread_of(self.begin(initial)[0]).amax().item() <= threshold

    def typical_cost(self, states: Tensor) -> Tensor:
        r"""Cost that one state can affect, from trajectories x_0..x_T, (N, \*batch, T + 1, D).

        Here the cost of a whole motion: moving towards the goal pays off only on arrival.
        """
        return self.horizon * super().typical_cost(states)
