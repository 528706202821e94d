r"""The policy: an RBF network squashed to the actions' range (Eqs. 25-27).

====================  ===========================================
paper                 here
====================  ===========================================
c_i (Eq. 26)          ``centres`` (m, D'), shared by the outputs
w_i (Eq. 25)          ``weights`` (m, F)
gamma (Eq. 26)        ``exp(log_widths)`` (F, D'), a row for each output
u_max (Eq. 27)        ``u_max`` (F,), around ``u_middle`` (F,)
====================  ===========================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from torch_pmil.checks import check_tensor
from torch_pmil.control.policy import SquashedController, SquashedPolicy, ridge_change
from torch_pmil.gp.gaussian import Gaussian, Moments
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_matching import exact_moments, moment_match


class RBFPolicy(SquashedPolicy):
    r"""RBF network whose output is squashed to the range of the actions (Eqs. 25-27).

    .. math:: \pi(x) = \bar u + u_{\max} \sin\left(
        \sum_i w_i \exp(-\tfrac12 (x - c_i)^\top \Gamma^{-1} (x - c_i)) \right)

    The paper's actions are torques within :math:`\pm u_{\max}`, so that :math:`\bar u = 0`. There
    are m (D' + F) + F D' parameters, of order one for inputs that are divided by ``scale``.

    Args:
        centres: (m, D'), in the units of the inputs.
        u_max: largest distances (F,) of an action from the middle of its range, in its unit.
        scale: typical size of each input (D',), in its unit.
        u_middle: middles of the actions' ranges (F,); None for zero.

    Raises:
        TypeError: one of them is not a tensor.
        ValueError: one has another shape, or a number is not finite or not positive.

    Example:
        >>> u_max = torch.tensor([3.5, 3.5])
        >>> policy = RBFPolicy(torch.zeros(100, 6), u_max, scale=torch.ones(6))
        >>> sum(p.numel() for p in policy.parameters())
        812
        >>> policy(torch.zeros(6)).shape
        torch.Size([2])
    """

    def __init__(
        self, centres: Tensor, u_max: Tensor, scale: Tensor, u_middle: Tensor | None = None
    ) -> None:
        check_tensor("centres", centres, ("m", "inputs"))
        m, inputs = centres.shape
        check_tensor("scale", scale, (inputs,))
        super().__init__(scale, u_max, u_middle)
        self.centres = nn.Parameter(centres.double() / self.scale)
        self.weights = nn.Parameter(torch.zeros(m, len(u_max), dtype=torch.float64))
        self.log_widths = nn.Parameter(torch.zeros(len(u_max), inputs, dtype=torch.float64))

    @property
    def controller(self) -> Controller:
        """The policy at its present parameters, with their graph; build it once for a rollout."""
        network = KernelExpansion(
            inputs=self.centres * self.scale,
            weights=self.weights.mT,
            lengthscales=self.log_widths.exp() * self.scale,
            signal_variance=torch.ones_like(self.u_max),
        )
        return Controller(network, *self.limits)

    def _fit(self, features: Tensor, raw: Tensor, ridge: float) -> None:
        basis = self.controller.network.kernel(features).transpose(0, 1)  # (F, S, m)
        weights = self.weights.mT[..., None]  # (F, m, 1)
        change = ridge_change(basis, raw.mT[..., None] - basis @ weights, ridge)
        self.weights.copy_((weights + change)[..., 0].mT)

    @torch.no_grad()
    def for_target(self, target: Tensor) -> RBFPolicy:
        """The policy for one target (K,), a function of the features alone (Eq. 31).

        The target is the last K of this policy's inputs. Raises ValueError if it is not finite, or
        leaves no features.
        """
        check_tensor("target", target, ("K",))
        D = len(self.scale) - len(target)
        if D < 1:
            raise ValueError(
                f"target must leave some of the {len(self.scale)} inputs, got {len(target)} entries"
            )
        network = self.controller.network.at_known(target.double()[None])
        policy = RBFPolicy(network.inputs, self.u_max, self.scale[:D], self.u_middle)
        policy.weights.copy_(network.weights[0].mT)
        policy.log_widths.copy_(self.log_widths[:, :D])
        return policy


@dataclass(frozen=True, eq=False)
class PolicyAtTargets:
    """A policy whose last K inputs are a target, at N targets (Eq. 31).

    Row i of a batch of N states is for target i of ``targets`` (N, K). A target has no variance, so
    that its part of the network is a factor of the weights.
    """

    policy: RBFPolicy
    targets: Tensor

    @property
    def controller(self) -> Controller:
        """Controller at the features of N states, one for each target."""
        controller = self.policy.controller
        return replace(controller, network=controller.network.at_known(self.targets))


@dataclass(frozen=True, eq=False)
class Controller(SquashedController):
    """An RBF network, and the range to which its output is squashed (Eq. 27)."""

    network: KernelExpansion
    u_max: Tensor
    u_middle: Tensor

    @property
    def parameters(self) -> tuple[Tensor, Tensor, Tensor]:
        """Centres (m, D'), weights (F, m) or (N, F, m), and widths (F, D') of the network."""
        return self.network.inputs, self.network.weights, self.network.lengthscales

    def raw(self, features: Tensor) -> Tensor:
        """Output of the network."""
        return self.network.mean(features)

    def raw_moments(self, features: Gaussian) -> Moments:
        """Its moments (Eqs. 25 and 26)."""
        return moment_match(self.network, features)

    def unchecked_moments(self, features: Gaussian) -> Moments:
        """The same at N beliefs, with no check but that of Cholesky factors."""
        return exact_moments(self.network, features)
