"""The loss of a robot that imitates first, and then improves what it was shown by a cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Unpack

import torch
from torch import Tensor

from torch_pmil.checks import check_positive
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.compiled.plans import Objective, Parameters
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.losses import FAR, TrajectoryKLLoss
from torch_pmil.search.target_costs import Cost
from torch_pmil.search.trajectory_loss import LossOptions, Penalty, TrajectoryLoss

# method of the KL: that of the cost which is added to it
BESIDE = {
    "per_step": "per_step",
    "mean_per_step": "mean_per_step",
    "cross_entropy_per_step": "per_step",
}


class ImprovingKLLoss(TrajectoryKLLoss):
    r"""KL to the demonstrations, and from :meth:`improve` on the sum of a cost and this KL.

    .. math:: \sum_t c_t + w \, \mathrm{KL}(p(x_t^{\exp}) \,\|\, p(x_t^\pi))

    Each evaluation of the sum predicts twice. A search trusts its prediction where this is sure
    (:meth:`TrajectoryLoss.spread`), since a better motion differs from the demonstrated one.

    Args:
        actor_network, dynamics, space, demonstrated, noise_std, options: as in
            :class:`TrajectoryKLLoss`.
        cost: c, of the state or of states and actions.
        imitation_weight: w, costs for each nat.

    Raises:
        ValueError: as there, the weight is not positive, or the cost is of another match space.

    Example:
        >>> from torch_pmil import GPDynamics, RBFPolicy, SaturatingCost
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 1), torch.ones(1), torch.ones(1))
        >>> shown = Gaussian(torch.zeros(5, 1).double(), torch.ones(5, 1, 1).double())
        >>> cost = SaturatingCost(target={"q": 1.0}, width=0.5)
        >>> loss = ImprovingKLLoss(policy, GPDynamics(2, 1), space, shown, 0.1, cost, 0.5)
        >>> loss.improving.item()
        False
    """

    label, unit = "loss", ""  # of both phases, which have different units

    def __init__(
        self,
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
        space: StateSpace,
        demonstrated: Gaussian,
        noise_std: float | Tensor,
        cost: Cost,
        imitation_weight: float,
        **options: Unpack[LossOptions],
    ) -> None:
        super().__init__(actor_network, dynamics, space, demonstrated, noise_std, **options)
        self.imitation_weight = check_positive("imitation_weight", imitation_weight)
        # in a tuple, so that policy and model are not registered a second time
        self._parts = (cost.loss(actor_network, dynamics, space, self.horizon),)
        self.register_buffer("improving", torch.tensor(False))

    @property
    def cost(self) -> TrajectoryLoss:
        """The expected cost alone, of the same policy and model."""
        return self._parts[0]

    def improve(self, begin: bool = True) -> None:
        """Count the cost from now on, or go back to imitation."""
        self.improving.fill_(begin)

    @property
    def has_moments(self) -> bool:
        """Whether what counts now is known in closed form."""
        improving = self._buffers.get("improving")  # the base class asks before there is one
        return super().has_moments and not (improving and not self.cost.has_moments)

    def per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """KL of each predicted marginal, with the cost once improving, (*batch, horizon)."""
        return self._with_cost("per_step", super().per_step(initial, horizon), initial, horizon)

    def mean_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """As :meth:`per_step`, for the model's mean alone, (*batch, horizon)."""
        imitation = super().mean_per_step(initial, horizon)
        return self._with_cost("mean_per_step", imitation, initial, horizon)

    def cross_entropy_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """As :meth:`per_step`, with the cross-entropy in place of the KL."""
        imitation = super().cross_entropy_per_step(initial, horizon)
        return self._with_cost("cross_entropy_per_step", imitation, initial, horizon)

    def step_loss_for_trust(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """KL of each step per observed entry; once improving, :meth:`TrajectoryLoss.spread`."""
        if self.improving:
            return self.spread(initial, horizon)
        return super().step_loss_for_trust(initial, horizon)

    def sample_costs(self, states: Tensor) -> Tensor:
        r"""Costs (N, \*batch, T) of sampled trajectories x_0..x_T, (N, \*batch, T + 1, D).

        The logarithmic distances of the KL, once the cost is added, are in nats near the
        demonstrations.
        """
        distances = super().sample_costs(states)
        if not self.improving:
            return distances
        nats = FAR * self.space.match_space.dim / 2 * distances
        return self.cost.sample_costs(states) + self.imitation_weight * nats

    def typical_cost(self, states: Tensor) -> Tensor:
        """Size of what counts now, for one step of sampled trajectories."""
        if self.improving:
            return TrajectoryLoss.typical_cost(self, states)
        return super().typical_cost(states)

    def objective(
        self, per_step: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
    ) -> Objective | None:
        """As that of the KL, or the weighted sum of both objectives; None if one is missing."""
        name = getattr(per_step, "__name__", "")
        imitation = super().objective(getattr(super(), name, per_step), initial, horizon)
        if not self.improving or imitation is None:
            return imitation
        of_cost = getattr(self.cost, BESIDE.get(name, ""), per_step)
        cost = self.cost.objective(of_cost, initial, horizon)
        return cost and partial(_sum, cost, imitation, self.imitation_weight)

    @contextmanager
    def penalised(self, penalty: Penalty) -> Iterator[None]:
        """As in the base class; beside a cost, the penalty is added without a weight."""
        with self.cost.penalised(penalty) if self.improving else super().penalised(penalty):
            yield

    def _costs_of_beliefs(self, states: Gaussian) -> Tensor:
        imitation = super()._costs_of_beliefs(states)
        if not self.improving:
            return imitation
        return self.cost._costs_of_beliefs(states) + self.imitation_weight * imitation

    def _with_cost(
        self, name: str, imitation: Tensor, initial: Gaussian, horizon: int | None
    ) -> Tensor:
        """The result of a method for the KL or, once improving, the cost plus the weighted KL."""
        if not self.improving:
            return imitation
        cost = getattr(self.cost, BESIDE[name])(initial, horizon)
        return cost + self.imitation_weight * imitation

    def _apply(self, fn: Callable[[Tensor], Tensor]) -> Any:
        self.cost._apply(fn)
        return super()._apply(fn)


def _sum(
    cost: Objective, imitation: Objective, weight: float, parameters: Parameters
) -> tuple[float, Parameters] | None:
    """The weighted sum of two objectives and its gradients, as one :data:`Objective`."""
    of_cost, of_imitation = cost(parameters), imitation(parameters)
    if of_cost is None or of_imitation is None:
        return None
    centres, weights, log_widths = (
        first + weight * second for first, second in zip(of_cost[1], of_imitation[1], strict=True)
    )
    return of_cost[0] + weight * of_imitation[0], (centres, weights, log_widths)
