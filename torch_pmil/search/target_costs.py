"""Costs in a user's words: where the robot should be, and how far off is far."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_pmil.checks import check_names, check_number
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.files import short
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.sampled_cost import CostFunction, ExpectedSampledCost
from torch_pmil.search.target_losses import (
    ExpectedQuadraticCost,
    ExpectedSaturatingCost,
    TargetLoss,
)
from torch_pmil.settings import Settings, setting

END = 0.2  # share of a motion over which a robot should be at the target


@dataclass(frozen=True, eq=False)
class TargetCost(Settings):
    """Base class of costs of the distance from a target.

    Args:
        target: where the robot should be, by the names of entries of the match space, in their
            units. Entries that are not named do not count.

    Raises:
        TypeError, ValueError: the target is not a mapping of names to numbers, or the width is not
            positive.
    """

    prefix: ClassVar[str] = "cost."
    objective: ClassVar[type[TargetLoss]]

    target: Mapping[str, float]
    width: float = setting(
        ..., "distance from the target that is far", above=0, unit="the unit of the target"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.target, Mapping) or not self.target:
            raise TypeError(
                "target must say where the robot should be, as {'x': 0.0}, got "
                f"{short(self.target)}"
            )
        check_names("target", tuple(self.target))
        for name, value in self.target.items():
            check_number(f"target of {name}", value)

    def loss(
        self, policy: AnyPolicy, dynamics: ForwardModel, space: StateSpace, horizon: int
    ) -> TargetLoss:
        """The expected cost over a predicted trajectory."""
        target, counts = self._in(space.match_space)
        given = policy, dynamics, space, target, self.width, horizon
        return self.objective(*given, weight=counts.diag())

    def at_end(self, space: StateSpace) -> Callable[[Tensor], Tensor]:
        """Largest distance from the target over the end of a motion, in widths.

        The result maps states x_0..x_T, (*batch, T + 1, D), to (*batch); the end is the last fifth.
        """
        target, counts = self._in(space.match_space)

        def distance(states: Tensor) -> Tensor:
            last = max(1, round(END * (states.shape[-2] - 1)))
            apart = counts * (space.observe(states[..., -last:, :]) - target) / self.width
            return apart.norm(dim=-1).amax(-1)

        return distance

    @property
    def said(self) -> dict[str, object]:
        """What a run depends on, in types that JSON has."""
        target = {name: float(value) for name, value in self.target.items()}
        return {"cost": type(self).__name__, "target": target, "width": self.width}

    def _in(self, match_space: MatchSpace) -> tuple[Tensor, Tensor]:
        """The target, and ones for the entries that count, (M,) each."""
        names = match_space.names
        if unknown := [name for name in self.target if name not in names]:
            raise ValueError(
                f"target must name entries of the match space {', '.join(names)}, got "
                f"{', '.join(unknown)}"
            )
        values = [[float(self.target.get(name, 0)), name in self.target] for name in names]
        target, counts = torch.tensor(values, dtype=torch.float64).unbind(-1)
        return target, counts


@dataclass(frozen=True, eq=False)
class SaturatingCost(TargetCost):
    """PILCO's cost (Eq. 28): 0 at the target, almost 1 beyond two widths.

    What happens far from the target does not count, so the robot may first move away from it.

    Example:
        >>> SaturatingCost(target={"tip x": 0.0, "tip y": 0.6}, width=0.25).width
        0.25
    """

    objective: ClassVar[type[TargetLoss]] = ExpectedSaturatingCost


@dataclass(frozen=True, eq=False)
class QuadraticCost(TargetCost):
    """The squared distance from the target, in widths: what is far counts most.

    Example:
        >>> QuadraticCost(target={"x": 0.0}, width=0.1).said["cost"]
        'QuadraticCost'
    """

    objective: ClassVar[type[TargetLoss]] = ExpectedQuadraticCost


@dataclass(frozen=True, eq=False)
class FunctionCost:
    """A cost given by any function of states and actions; samples estimate its expectation.

    Args:
        function: as in :class:`~torch_pmil.search.sampled_cost.ExpectedSampledCost`.

    Raises:
        TypeError: it is not a function.

    Example:
        >>> FunctionCost(lambda states, actions: states.square().sum(-1)).said["cost"]
        '<lambda>'
    """

    objective: ClassVar[type[ExpectedSampledCost]] = ExpectedSampledCost
    function: CostFunction

    def __post_init__(self) -> None:
        if not callable(self.function) or isinstance(self.function, type):
            raise TypeError(
                "cost must be a SaturatingCost, a QuadraticCost or a function of states and "
                f"actions, got {short(self.function)}"
            )

    def loss(
        self, policy: AnyPolicy, dynamics: ForwardModel, space: StateSpace, horizon: int
    ) -> ExpectedSampledCost:
        """The expected cost over sampled trajectories."""
        return ExpectedSampledCost(policy, dynamics, space, self.function, horizon)

    @property
    def said(self) -> dict[str, object]:
        """What a run depends on: the name of the function."""
        return {"cost": getattr(self.function, "__qualname__", type(self.function).__name__)}


Cost = TargetCost | FunctionCost


def check_cost(cost: object) -> None:
    """Raise TypeError unless it is a cost in a user's words."""
    if not isinstance(cost, Cost):
        raise TypeError(
            "cost must be a SaturatingCost, a QuadraticCost or a FunctionCost, got "
            f"{type(cost).__name__}"
        )
