"""A task that is imitated first, and then improved by a cost (Englert et al. 2013)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.improving_loss import ImprovingKLLoss
from torch_pmil.search.sampled_cost import CostFunction
from torch_pmil.search.target_costs import Cost, FunctionCost, TargetCost, check_cost
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.settings import setting
from torch_pmil.tasks.task import Task


@dataclass(frozen=True, eq=False, kw_only=True)
class ImprovingTask(Task):
    """A task that is imitated first, and then improved by a cost.

    A success is what it is in imitation, before and after.

    Args:
        cost: what is minimised beside the KL to the demonstrations, once the robot imitates them.
        imitation_weight: of the KL beside the cost.

    Raises:
        TypeError, ValueError: as :class:`Task`; or the cost is of another kind or match space.
    """

    cost: Cost
    imitation_weight: float = setting(
        1.0,
        "how much the demonstrations count beside the cost, once they are imitated",
        above=0,
        unit="costs for each nat",
    )

    def __post_init__(self) -> None:
        check_cost(self.cost)
        if isinstance(self.cost, TargetCost):
            self.cost.at_end(self.space)  # raises ValueError if its target is of another space
        super().__post_init__()

    @property
    def objective(self) -> type[TrajectoryLoss]:
        """Class of the loss."""
        return ImprovingKLLoss

    @property
    def settings(self) -> dict[str, object]:
        """The settings of :class:`Task`, and the cost."""
        return {**super().settings, "cost": self.cost.said}

    def make_loss(self, policy: AnyPolicy, dynamics: ForwardModel) -> TrajectoryLoss:
        """The loss of the policy search: the KL, then the sum of cost and weighted KL."""
        beside = self.demonstrated, self.noise_std, self.cost, self.imitation_weight
        return ImprovingKLLoss(policy, dynamics, self.space, *beside)


def improving(task: Task, cost: Cost | CostFunction, **settings: Any) -> ImprovingTask:
    """The same task, which a cost improves once it is imitated.

    Args:
        task: with one target.
        cost: as that of :class:`~torch_pmil.tasks.cost_task.CostTask`, or a function, as in
            :class:`~torch_pmil.search.target_costs.FunctionCost`.
        settings: ``imitation_weight``, if it is not the default.

    Raises:
        TypeError, ValueError: as :class:`ImprovingTask`.

    Example:
        >>> from torch_pmil import SaturatingCost, load_experiment
        >>> cost = SaturatingCost(target={"x_tip": 0.0, "z_tip": 0.6}, width=0.3)
        >>> improving(load_experiment("cart_pole"), cost).imitation_weight
        1.0
    """
    own = {entry.name: getattr(task, entry.name) for entry in fields(task)}
    given = cost if isinstance(cost, Cost) else FunctionCost(cost)
    return ImprovingTask(**own, cost=given, **settings)
