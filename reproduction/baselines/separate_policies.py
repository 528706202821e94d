"""A policy for each target, to compare with one policy of all: blended, or the nearest alone."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torch_pmil.control.state_policy import StatePolicy


class SeparatePolicies(nn.Module):
    r"""Acts for any target as a weighted mean of the policies of S targets.

    .. math:: u = \sum_i \frac{w_i}{\sum_j w_j} \pi_i(x), \qquad w_i = \|\eta - \eta_i\|^{-2}

    Args:
        policies: one for each target.
        targets: these, (S, K).
        nearest: whether the policy of the nearest target acts alone.

    Raises:
        ValueError: there is not a policy for each target.

    Example: see ``reproduction/target_study.py``.
    """

    targets: Tensor

    def __init__(
        self, policies: Sequence[StatePolicy], targets: Tensor, nearest: bool = False
    ) -> None:
        super().__init__()
        if targets.ndim != 2 or len(policies) != len(targets):
            raise ValueError(
                "targets must have shape (S, K) with a policy for each, got "
                f"{tuple(targets.shape)} and {len(policies)} policies"
            )
        self.policies, self.nearest = nn.ModuleList(policies), nearest
        self.register_buffer("targets", targets)

    def forward(self, state: Tensor, target: Tensor) -> Tensor:
        """Torques (*batch, F), N·m, at states (*batch, D) for targets (*batch, K)."""
        torques = torch.stack([policy(state) for policy in self.policies], -1)
        return (torques @ self.shares(target)[..., None]).squeeze(-1)

    def shares(self, target: Tensor) -> Tensor:
        """Shares (*batch, S) of the policies for targets (*batch, K), which sum to 1.

        At a target of a policy, the share of that policy is 1.
        """
        distance = (target[..., None, :] - self.targets).norm(dim=-1)
        own = nn.functional.one_hot(distance.argmin(-1), len(self.targets)).to(distance)
        if self.nearest:
            return own
        closeness = distance.pow(-2)
        blended = closeness / closeness.sum(-1, keepdim=True)
        return torch.where(distance.amin(-1, keepdim=True) == 0, own, blended)
