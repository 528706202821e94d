r"""The policy of MC-PILCO: a squashed sum of Gaussians, of which some drop out at random.

.. math:: \pi(x) = \bar u + u_{\max} \tanh\left(
    \sum_i w_i \, e^{-\lVert a_i - \phi(x) \rVert^2_\Sigma} \right)
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from torch_pmil.control.action_space import ActionSpace


class SquashedNetwork(nn.Module):
    """Actions within their limits, of features; Sigma is diagonal and the same for all actions.

    Centres and widths are in units of ``scale``, weights in halves of the actions' ranges: all
    parameters are of order one.

    Args:
        centres: a, (m, D'), in the units of the features.
        scale: first widths, at which a basis function is exp(-1), (D',).
        weights: w, (m, F).
        actions: middle and half of their range.

    Example:
        >>> limits = ActionSpace.around(torch.zeros(1), torch.ones(1), ["u"], ["N"])
        >>> policy = SquashedNetwork(torch.zeros(3, 2), torch.ones(2), torch.ones(3, 1), limits)
        >>> policy(torch.zeros(5, 2).double()).shape
        torch.Size([5, 1])
    """

    def __init__(
        self, centres: Tensor, scale: Tensor, weights: Tensor, actions: ActionSpace
    ) -> None:
        super().__init__()
        self.scale = scale.double()
        self.middle, self.half_range = actions.middle.double(), actions.half_range.double()
        self.centres = nn.Parameter(centres.double() / self.scale)
        self.log_widths = nn.Parameter(torch.zeros_like(self.scale))
        self.weights = nn.Parameter(weights.double())

    def forward(self, features: Tensor) -> Tensor:
        """Actions (*batch, F) at features (*batch, D')."""
        return self.controller(0.0, torch.Generator())(features)

    def controller(self, dropout: float, generator: torch.Generator) -> Callable[[Tensor], Tensor]:
        """The policy as a function of its present parameters, with their graph.

        In each row of a batch every basis function is left out with probability ``dropout``, anew
        in every call, and the others count 1 / (1 - dropout) times: the sum's expectation stays.
        """
        precision = (-2 * self.log_widths).exp() / self.scale.square()
        a = self.centres * self.scale
        squares = -precision.expand_as(a)
        constant = (a.square() * squares).sum(-1, keepdim=True)
        exponents = torch.cat([2 * a * precision, squares, constant], -1)  # of [x, x^2, 1]
        weights = self.weights / (1 - dropout)

        def act(features: Tensor) -> Tensor:
            terms = [features, features.square(), torch.ones_like(features[..., :1])]
            basis = (torch.cat(terms, -1) @ exponents.mT).exp()  # (*batch, m)
            if dropout:
                drawn = torch.rand(basis.shape, generator=generator)
                basis = basis * (drawn + (1 - dropout)).floor_().to(basis)  # times 0 or 1
            return self.middle + self.half_range * (basis @ weights).tanh()

        return act
