"""How far rollouts are from the demonstrations, in their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class Deviation:
    """Root mean square distance from the demonstrated mean, in standard deviations.

    Args:
        demonstrated: marginals at t = 1..T, mean (T, M) in the match space.
        space: of the states.
    """

    demonstrated: Gaussian
    space: StateSpace

    def __call__(self, states: Tensor) -> Tensor:
        """Errors (*batch) of states x_0..x_T, (*batch, T + 1, D)."""
        apart = self.space.observe(states[..., 1:, :]) - self.demonstrated.mean
        return (apart / self.demonstrated.std).square().mean((-2, -1)).sqrt()

    def every(self, periods: int) -> Self:
        """That of every so many steps."""
        return replace(self, demonstrated=self.demonstrated[periods - 1 :: periods])
