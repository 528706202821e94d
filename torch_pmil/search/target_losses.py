"""Losses by the distance from a target: PILCO's saturating cost (Eq. 28), and the quadratic one."""

from __future__ import annotations

from typing import Unpack

import torch
from torch import Tensor

from torch_pmil.checks import check_positive, check_tensor
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.compiled.plans import Comparison
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.expected_cost import ExpectedCost
from torch_pmil.search.saturating_cost import expected_saturating_cost, saturating_cost
from torch_pmil.search.trajectory_loss import LossOptions


class TargetLoss(ExpectedCost):
    r"""Base class of expected costs of the distance from a target, summed over the horizon.

    .. math:: r = R(z - z_{\mathrm{target}}), \qquad R^\top R = W / \sigma^2

    A subclass gives the cost of r, which counts the distance in widths. The expectation is over a
    Gaussian with the exact predicted moments of z in the match space, without observation noise.
    The entry is ``"loss_cost"``.

    Args:
        actor_network, dynamics, space: as in :class:`TrajectoryLoss`.
        target: the target, (M,), in the match space.
        width: :math:`\sigma`, in the unit of the distance.
        horizon: T, number of steps after the start.
        weight: W, (M, M), symmetric and positive semi-definite; the identity by default. Zeros
            ignore an entry.
        options: ``reduction``, ``prediction`` and ``mean_prediction``, as there.

    Raises:
        ValueError: shapes do not fit the match space, a number is not positive, W is indefinite, or
            the reduction is unknown.
    """

    def __init__(
        self,
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
        space: StateSpace,
        target: Tensor,
        width: float,
        horizon: int,
        weight: Tensor | None = None,
        **options: Unpack[LossOptions],
    ) -> None:
        super().__init__(actor_network, dynamics, space, horizon, **options)
        M = space.match_space.dim
        if target.shape != (M,):
            raise ValueError(
                f"target must have shape ({M},), the entries {space.match_space.names}, got "
                f"{tuple(target.shape)}"
            )
        check_tensor("target", target, (M,))
        width = check_positive("width", width)
        weight = torch.eye(M) if weight is None else weight
        check_tensor("weight", weight, (M, M))
        self.register_buffer("target", target.double())
        self.register_buffer("to_widths", _root(weight.double()) / width)

    def _residual(self, observed: Gaussian) -> Gaussian:
        """Beliefs over r."""
        return Gaussian(observed.mean - self.target, observed.cov).affine(self.to_widths)

    def _residual_of(self, observed: Tensor) -> Tensor:
        return (observed - self.target) @ self.to_widths.mT


class ExpectedSaturatingCost(TargetLoss):
    r"""PILCO's expected cost of not being at a target (Eq. 28), summed over the horizon: 0 to T.

    .. math:: \sum_t \mathbb E\left[1 - \exp\left(-\tfrac12 \|r_t\|^2\right)\right]

    Eq. 28 itself has :math:`\sigma` = 2 and W = I. Arguments and errors are those of
    :class:`TargetLoss`.

    Example:
        >>> from tensordict import TensorDict
        >>> from torch_pmil import GPDynamics, RBFPolicy
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 1), torch.ones(1), torch.ones(1))
        >>> dynamics = GPDynamics(2, 1)
        >>> dynamics.set_data(torch.eye(2), torch.zeros(2, 1))
        >>> loss = ExpectedSaturatingCost(policy, dynamics, space, torch.ones(1), 0.5, horizon=5)
        >>> start = {"mean": torch.zeros(1).double(), "var": torch.eye(1).double()}
        >>> 0 < loss(TensorDict({"observation": start}))["loss_cost"].item() < 5
        True
    """

    def sample_costs(self, states: Tensor) -> Tensor:
        r"""Logarithmic costs (N, \*batch, T) of sampled trajectories x_0..x_T.

        .. math:: \log\left(1 + \tfrac12 \|r\|^2\right)

        Near the target they are the saturating costs. Trajectories far from it, as those of a
        random policy, have a slope all the same.
        """
        residual = self._residual_of(self.space.observe(states[..., 1:, :]))
        return torch.log1p(residual.square().sum(-1) / 2)

    def _costs(self, observed: Gaussian) -> Tensor:
        return expected_saturating_cost(self._residual(observed))

    def _mean_costs(self, observed: Tensor) -> Tensor:
        return saturating_cost(self._residual_of(observed))

    def _comparison(self, horizon: int) -> Comparison:
        match_space, to_widths = self.space.match_space, self.to_widths
        target = (-self.target @ to_widths.mT).expand(horizon, -1)
        weights = to_widths @ match_space.weights.to(to_widths)
        noise = torch.zeros_like(to_widths)
        return Comparison(match_space.augmentation, weights, target, noise, None)


class ExpectedQuadraticCost(TargetLoss):
    r"""Expected squared distance from a target in widths, summed over the horizon.

    .. math:: \sum_t \mathbb E\left[\|r_t\|^2\right] =
        \sum_t \|\mathbb E[r_t]\|^2 + \operatorname{tr} \operatorname{cov}(r_t)

    Far states count most. Arguments and errors are those of :class:`TargetLoss`.

    Example:
        >>> from torch_pmil import GPDynamics, RBFPolicy
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 1), torch.ones(1), torch.ones(1))
        >>> loss = ExpectedQuadraticCost(policy, GPDynamics(2, 1), space, torch.ones(1), 0.5, 1)
        >>> loss._costs(Gaussian(torch.zeros(1).double(), torch.ones(1, 1).double())).item()
        8.0
    """

    def _costs(self, observed: Gaussian) -> Tensor:
        residual = self._residual(observed)
        spread = residual.cov.diagonal(dim1=-2, dim2=-1).sum(-1)
        return residual.mean.square().sum(-1) + spread

    def _mean_costs(self, observed: Tensor) -> Tensor:
        return self._residual_of(observed).square().sum(-1)


def _root(weight: Tensor) -> Tensor:
    """Matrix R with R'R = W, for a W that may be singular."""
    values, vectors = torch.linalg.eigh(weight)
    if not torch.allclose(weight, weight.mT) or values[0] < -1e-12 * values[-1]:
        raise ValueError(
            f"weight must be symmetric and positive semi-definite, got {weight.tolist()}"
        )
    return values.clamp(min=0).sqrt()[:, None] * vectors.mT
