"""What a prediction asks of a policy."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor, nn

from torch_pmil.checks import check_positive, check_positive_entries, check_tensor
from torch_pmil.gp.gaussian import Gaussian, Moments
from torch_pmil.gp.trigonometry import squash

# bound of the sine when Eq. 27 is inverted, since its slope at 1 is zero
MAX_SINE = 0.999
Act = Callable[[Tensor], Tensor]  # actions (*batch, F) at features of the state (*batch, D')


class Policy(Protocol):
    """Anything that gives a controller to a prediction.

    A :class:`SquashedController` acts on beliefs too, so that moments are known in closed form. Any
    other function of the features is predicted by samples.
    """

    @property
    def controller(self) -> Act:
        """Controller of one state, or of N states for N targets."""


class SquashedController:
    """A controller whose output, with moments in closed form, is squashed to a range (Eq. 27).

    A subclass has ``u_max``, the largest distances (F,) of an action from ``u_middle`` (F,).
    """

    u_max: Tensor
    u_middle: Tensor

    @abstractmethod
    def raw(self, features: Tensor) -> Tensor:
        """Output before the squashing, (*batch, F), rad, at features (*batch, D')."""

    @abstractmethod
    def raw_moments(self, features: Gaussian) -> Moments:
        """Its moments at a belief over the features."""

    def unchecked_moments(self, features: Gaussian) -> Moments:
        """:meth:`raw_moments` at N beliefs, which need not be checked."""
        return self.raw_moments(features)

    def __call__(self, features: Tensor) -> Tensor:
        """Action (*batch, F) at features of the state (*batch, D')."""
        return self.u_middle + self.u_max * self.raw(features).sin()

    def on_belief(self, features: Gaussian) -> tuple[Gaussian, Tensor]:
        """Exact belief over the action at one over the features.

        The second result is Sigma^-1 cov(features, action), (*batch, D', F).
        """
        return self.squashed(self.raw_moments(features))

    def squashed(self, raw: Moments) -> tuple[Gaussian, Tensor]:
        """:meth:`on_belief` from the moments before the squashing."""
        action, slope = squash(raw.gaussian, self.u_max)
        action = Gaussian(self.u_middle + action.mean, action.cov)
        return action, raw.inv_cov_cross_cov * slope[..., None, :]


class PolicyNetwork(nn.Module):
    """Base class of policies with parameters, from features to actions within their range.

    Args:
        scale: typical size of each input (D',), in its unit.
        u_max: largest distances (F,) of an action from the middle of its range, in its unit.
        u_middle: middles of the actions' ranges (F,); None for zero.

    Raises:
        TypeError: one of them is not a tensor.
        ValueError: one has another shape, or a number is not finite or not positive.
    """

    u_max: Tensor
    u_middle: Tensor
    scale: Tensor

    def __init__(self, scale: Tensor, u_max: Tensor, u_middle: Tensor | None = None) -> None:
        super().__init__()
        check_tensor("scale", scale, ("inputs",))
        check_tensor("u_max", u_max, ("F",))
        check_positive_entries("scale", scale)
        check_positive_entries("u_max", u_max)
        u_middle = torch.zeros_like(u_max) if u_middle is None else u_middle
        check_tensor("u_middle", u_middle, (len(u_max),))
        self.register_buffer("u_max", u_max.double())
        self.register_buffer("u_middle", u_middle.double())
        self.register_buffer("scale", scale.double())

    @property
    def num_inputs(self) -> int:
        """Number D' of features that it sees, and of a target's entries."""
        return len(self.scale)


class SquashedPolicy(PolicyNetwork):
    """Base class of policies that are squashed by a sine, with moments in closed form."""

    @property
    @abstractmethod
    def controller(self) -> SquashedController:
        """The policy at its present parameters, with their graph; build it once for a rollout."""

    @abstractmethod
    def _fit(self, features: Tensor, raw: Tensor, ridge: float) -> None:
        """Fit the parameters to outputs before the squashing (S, F) at features (S, D')."""

    @property
    def limits(self) -> tuple[Tensor, Tensor]:
        """Largest distances (F,) from the middles (F,), and the middles."""
        return self.u_max, self.u_middle

    def forward(self, features: Tensor) -> Tensor:
        """Action (*batch, F) at finite features of the state (*batch, D')."""
        check_tensor("features", features, ("*batch", self.num_inputs))
        return self.controller(features.double())

    @torch.no_grad()
    def fit_weights(self, features: Tensor, actions: Tensor, ridge: float = 0.1) -> None:
        """Fit the parameters to given actions by ridge regression around the present ones.

        An RBF network keeps its centres and widths (Eq. 25).

        Args:
            features: (S, D').
            actions: (S, F), in their units, within their range.
            ridge: positive penalty of a change of the parameters, beside actions in rad.

        Example:
            >>> from torch_pmil import RBFPolicy
            >>> policy = RBFPolicy(torch.zeros(1, 1), u_max=torch.ones(1), scale=torch.ones(1))
            >>> policy.fit_weights(torch.zeros(1, 1), torch.full((1, 1), 0.5), ridge=1e-9)
            >>> round(policy(torch.zeros(1)).item(), 6)
            0.5
        """
        check_tensor("features", features, ("S", self.num_inputs))
        check_tensor("actions", actions, (len(features), len(self.u_max)))
        ridge = check_positive("ridge", ridge)
        raw = before_squashing((actions - self.u_middle) / self.u_max)
        self._fit(features.double(), raw, ridge)


def before_squashing(sines: Tensor) -> Tensor:
    """What is squashed to actions (*batch, F) in units of ``u_max``: the inverse of Eq. 27, rad."""
    return sines.clamp(-MAX_SINE, MAX_SINE).asin()


def ridge_change(basis: Tensor, missing: Tensor, ridge: float) -> Tensor:
    """Change of weights (*batch, m, F) that explains (*batch, S, F) by a basis (*batch, S, m)."""
    gram = basis.mT @ basis + ridge * torch.eye(basis.shape[-1]).to(basis)
    return torch.cholesky_solve(basis.mT @ missing, torch.linalg.cholesky(gram))
