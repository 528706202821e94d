"""A linear policy squashed to the actions' range, with moments in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torch_pmil.control.policy import SquashedController, SquashedPolicy, ridge_change
from torch_pmil.gp.gaussian import Gaussian, Moments


class LinearPolicy(SquashedPolicy):
    r"""Linear feedback whose output is squashed to the range of the actions (Eq. 27).

    .. math:: \pi(x) = \bar u + u_{\max} \sin(A\,(x / s) + b)

    A robot is held near one state by few parameters, F (D' + 1), of order one for inputs that are
    divided by their typical sizes s. In place of a new RBF network, ``PMIL(..., policy=
    LinearPolicy)`` searches it, by moments in closed form.

    Args:
        scale: s, (D',), in the units of the inputs.
        u_max: largest distances (F,) of an action from the middle of its range, in its unit.
        u_middle: middles of the actions' ranges (F,); None for zero.

    Raises:
        TypeError: one of them is not a tensor.
        ValueError: one has another shape, or a number is not finite or not positive.

    Source: Deisenroth (2010), section 3.5.1.

    Example:
        >>> policy = LinearPolicy(torch.ones(3), u_max=torch.tensor([2.0]))
        >>> sum(parameter.numel() for parameter in policy.parameters())
        4
        >>> policy(torch.zeros(5, 3)).shape
        torch.Size([5, 1])
    """

    def __init__(self, scale: Tensor, u_max: Tensor, u_middle: Tensor | None = None) -> None:
        super().__init__(scale, u_max, u_middle)
        F = len(self.u_max)
        self.gains = nn.Parameter(torch.zeros(F, self.num_inputs, dtype=torch.float64))
        self.offsets = nn.Parameter(torch.zeros(F, dtype=torch.float64))

    @property
    def controller(self) -> LinearController:
        """The policy at its present parameters, with their graph; build it once for a rollout."""
        return LinearController(self.gains / self.scale, self.offsets, *self.limits)

    def _fit(self, features: Tensor, raw: Tensor, ridge: float) -> None:
        basis = torch.nn.functional.pad(features / self.scale, (0, 1), value=1.0)  # (S, D' + 1)
        weights = torch.cat([self.gains, self.offsets[:, None]], -1).mT
        change = ridge_change(basis, raw - basis @ weights, ridge).mT
        self.gains.add_(change[:, :-1])
        self.offsets.add_(change[:, -1])


@dataclass(frozen=True, eq=False)
class LinearController(SquashedController):
    """Linear feedback with gains (F, D') and offsets (F,), rad, squashed to a range (Eq. 27)."""

    gains: Tensor
    offsets: Tensor
    u_max: Tensor
    u_middle: Tensor

    def raw(self, features: Tensor) -> Tensor:
        """Linear output."""
        return features @ self.gains.mT + self.offsets

    def raw_moments(self, features: Gaussian) -> Moments:
        """Its moments, which are those of a linear function of a Gaussian."""
        slope = self.gains.mT.expand(*features.batch_shape, -1, -1)
        return Moments(self.raw(features.mean), self.gains @ features.cov @ slope, slope)
