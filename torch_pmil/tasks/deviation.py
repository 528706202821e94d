"""How far rollouts are from the demonstrations, in their standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from torch import Tensor

from torch_pmil.checks import check_positive
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class Deviation:
    """Root mean square distance from the demonstrated mean, in standard deviations.

    With ``allowed``, the root mean square distance of each named entry over time is divided by its
    largest allowed distance. The error is the largest ratio, so a success has at most 1.

    Args:
        demonstrated: marginals at t = 1..T, mean (T, M) in the match space.
        space: of the states.
        allowed: largest distances by entry of the match space, in its unit; None for all entries
            in standard deviations.

    Raises:
        ValueError: an entry is unknown, or a distance is not positive.
    """

    demonstrated: Gaussian
    space: StateSpace
    allowed: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        known = self.space.match_space.names
        for name, distance in (self.allowed or {}).items():
            if name not in known:
                raise ValueError(
                    f"tolerance must be by entries of the demonstrations, {', '.join(known)}, got "
                    f"{name}"
                )
            check_positive(f"tolerance of {name}", distance)

    def __call__(self, states: Tensor) -> Tensor:
        """Errors (*batch) of states x_0..x_T, (*batch, T + 1, D)."""
        apart = self.space.observe(states[..., 1:, :]) - self.demonstrated.mean
        if self.allowed is None:
            return (apart / self.demonstrated.std).square().mean((-2, -1)).sqrt()
        known = self.space.match_space.names
        chosen = apart[..., [known.index(name) for name in self.allowed]]
        distances = chosen.square().mean(-2).sqrt()
        return (distances / distances.new_tensor(list(self.allowed.values()))).amax(-1)

    def every(self, periods: int) -> Self:
        """The deviation at every ``periods``-th step alone."""
        return replace(self, demonstrated=self.demonstrated[periods - 1 :: periods])
