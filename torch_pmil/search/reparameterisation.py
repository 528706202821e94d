"""Variables in which the policy of a loss is easy to search."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.func import functional_call

from torch_pmil.control.linear_policy import LinearPolicy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import differentiated, in_one_vector
from torch_pmil.search.trajectory_loss import TrajectoryLoss

NOISE_VARIANCE = 0.1  # noise variance of the values; the basis functions are at most 1
WEIGHTS = "loss.actor_network.weights"


class LinearPolicyLoss:
    """A loss as a function of the parameters of its linear policy, which are easy to search."""

    def __init__(self, loss: TrajectoryLoss) -> None:
        self.variables = list(loss.actor_network.parameters())

    def as_function(
        self, per_step: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
    ) -> Callable[[Tensor], tuple[float, Tensor]]:
        """Sum of one of the loss's methods, and its gradient, at all variables in one vector."""
        return differentiated(self.variables, lambda: per_step(initial, horizon).sum())

    def write(self) -> None:
        """Nothing to do: the variables are the parameters."""


def reparameterised(loss: TrajectoryLoss) -> LinearPolicyLoss | ReparameterisedLoss:
    """The loss in variables in which its policy is easy to search."""
    if isinstance(loss.actor_network, LinearPolicy):
        return LinearPolicyLoss(loss)
    return ReparameterisedLoss(loss)


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
        >>> ReparameterisedLoss(task.make_loss(policy, task.make_dynamics())).values.shape
        torch.Size([2, 100, 1])
    """

    def __init__(self, loss: TrajectoryLoss) -> None:
        super().__init__()
        policy = loss.actor_network
        if not isinstance(policy, RBFPolicy):
            raise TypeError(
                f"search_policy needs an RBFPolicy or a LinearPolicy, got {type(policy).__name__}, "
                "which is searched by search_on_samples"
            )
        self.loss, self._policy = loss, (policy,)  # once among the modules
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
        weights = self._weights(self.values)
        return functional_call(self, {WEIGHTS: weights}, arguments, tie_weights=False)

    def as_function(
        self, per_step: Callable[[Gaussian, int], Tensor], initial: Gaussian, horizon: int
    ) -> Callable[[Tensor], tuple[float, Tensor]]:
        """:meth:`total` as a function of all variables in one vector that knows its gradient.

        Kernels compute it without a graph if they serve the loss. Where they fail, the formulas
        compute it, or name what is wrong.
        """
        by_formulas = differentiated(self.variables, lambda: self.total(per_step, initial, horizon))
        objective = self.loss.objective(per_step, initial, horizon)
        if objective is None:
            return by_formulas
        shapes = [variable.shape for variable in self.variables]
        sizes = [shape.numel() for shape in shapes]

        def function(point: Tensor) -> tuple[float, Tensor]:
            parts = zip(point.split(sizes), shapes, strict=True)
            centres, values, log_widths = (part.view(shape) for part, shape in parts)
            found = objective((centres, self._weights(values), log_widths))
            if found is None:
                return by_formulas(point)
            loss, (of_centres, of_weights, of_log_widths) = found
            of_values = torch.cholesky_solve(of_weights.mT[..., None], self.root)
            return loss, in_one_vector((of_centres, of_values, of_log_widths))

        return function

    @torch.no_grad()
    def write(self) -> None:
        """Give the policy the weights that follow from the values."""
        self._policy[0].weights.copy_(self._weights(self.values))

    def _weights(self, values: Tensor) -> Tensor:
        return torch.cholesky_solve(values, self.root)[..., 0].mT
