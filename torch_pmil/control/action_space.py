"""What a robot takes: names, units and ranges of its actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from torch import Tensor

from torch_pmil.checks import check_tensor
from torch_pmil.control.state_space import with_unit


@dataclass(frozen=True, eq=False)
class ActionSpace:
    """Names, units and ranges of the F actions of a robot: torques, or targets of its servos.

    Args:
        names, units: of the actions; "" for a unit that is not known.
        low, high: least and largest actions, (F,), in those units.

    Raises:
        TypeError: a bound is not a tensor.
        ValueError: sizes do not fit, a name comes twice, or bounds are not finite and ordered.

    Example:
        >>> import torch
        >>> low, high = torch.tensor([-4.0, 0.0]), torch.tensor([4.0, 2.0])
        >>> targets = ActionSpace(("q1", "q2"), ("rad", "rad"), low, high)
        >>> targets.middle.tolist(), targets.half_range.tolist()
        ([0.0, 1.0], [4.0, 1.0])
        >>> print(targets)
        q1 (rad) from -4 to 4, q2 (rad) from 0 to 2
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    low: Tensor
    high: Tensor

    def __post_init__(self) -> None:
        F = len(self.names)
        if not F or len(self.units) != F:
            raise ValueError(
                f"actions must have a name and a unit each, got {self.names} and {self.units}"
            )
        if len(set(self.names)) < F:
            raise ValueError(f"names of actions must be different, got {self.names}")
        for name in ("low", "high"):
            check_tensor(name, getattr(self, name), (F,))
        if not (self.low < self.high).all():
            raise ValueError(
                f"low must be below high, got {self.low.tolist()} and {self.high.tolist()}"
            )

    @classmethod
    def around(
        cls, middle: Tensor, half_range: Tensor, names: Sequence[str], units: Sequence[str]
    ) -> Self:
        """Actions within ``half_range`` of ``middle``, (F,) each; names default to numbers."""
        F = len(middle)
        names = tuple(names) or tuple(map(str, range(F)))
        low, high = middle - half_range, middle + half_range
        return cls(names, tuple(units) or ("",) * F, low, high)

    @property
    def middle(self) -> Tensor:
        """Middles of the ranges, (F,)."""
        return (self.low + self.high) / 2

    @property
    def half_range(self) -> Tensor:
        """Largest distances of an action from the middle of its range, (F,)."""
        return (self.high - self.low) / 2

    @property
    def labels(self) -> tuple[str, ...]:
        """Names for figures, with the units that are known."""
        named = zip(self.names, self.units, strict=True)
        return tuple(with_unit(f"action {name}", unit) for name, unit in named)

    def __str__(self) -> str:
        ranges = zip(self.names, self.units, self.low.tolist(), self.high.tolist(), strict=True)
        return ", ".join(
            f"{with_unit(name, unit)} from {low:g} to {high:g}" for name, unit, low, high in ranges
        )
