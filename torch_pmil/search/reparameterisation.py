"""Variables in which the policy of a loss is easy to search."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.func import functional_call

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.trajectory_loss import TrajectoryLoss

NOISE_VARIANCE = 0.1  # noise variance of the values; the basis functions are at most 1
WEIGHTS = "loss.actor_network.weights"


class ReparameterisedLoss(nn.Module):
    r"""A loss as a function of the policy's centres and widths, and of values in place of weights.

    .. math:: w = (K + \sigma^2 I)^{-1} y, \qquad K_{ij} = \phi_j(\mu_i)

    The values y are about the outputs of the network at its centres :math:`\mu`, as in PILCO, whose
    policy is a Gaussian process with y as targets. K stays as it is at the start of the search.
    Basis functions overlap, so a gradient step in the weights changes the network everywhere. One
    in the values changes it where it should change, and L-BFGS needs a fraction of the iterations.

    Args:
        loss: the loss to search. L-BFGS changes centres and widths of its policy, :meth:`write` the
            weights.

    Example:
        >>> from torch_pmil.tasks.registry import load_experiment
        >>> task = load_experiment("double_pendulum")
        >>> policy = task.make_policy(torch.Generator().manual_seed(0))
        >>> ReparameterisedLoss(task.make_loss(policy, None)).values.shape
        torch.Size([2, 100, 1])
    """

    def __init__(self, loss: TrajectoryLoss) -> None:
        super().__init__()
        self.loss, policy = loss, loss.actor_network
        with torch.no_grad():
            basis = policy.controller.network.kernel(policy.centres * policy.scale)  # (m, F, m)
            gram = basis.transpose(0, 1)
            gram = gram + NOISE_VARIANCE * torch.eye(gram.shape[-1]).to(gram)
            self.root = torch.linalg.cholesky(gram)
            self.values = nn.Parameter(gram @ policy.weights.mT[..., None])  # (F, m, 1)
        self.variables = [policy.centres, self.values, policy.log_widths]

    def forward(
        self, per_step: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
    ) -> Tensor:
        """Sum of one of the loss's methods over the steps up to a horizon."""
        return per_step(initial, horizon).sum()

    def total(
        self, per_step: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
    ) -> Tensor:
        """:meth:`forward` with the weights that the values give: a function of the variables."""
        arguments = per_step, initial, horizon
        return functional_call(self, {WEIGHTS: self._weights()}, arguments, tie_weights=False)

    @torch.no_grad()
    def write(self) -> None:
        """Give the policy the weights that follow from the values."""
        self.loss.actor_network.weights.copy_(self._weights())

    def _weights(self) -> Tensor:
        return torch.cholesky_solve(self.values, self.root)[..., 0].mT
