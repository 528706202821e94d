"""Losses of a policy: KL to the demonstrations (Eq. 20), or PILCO's saturating cost (Eq. 28)."""

from __future__ import annotations

from dataclasses import replace
from typing import Unpack

import torch
from torch import Tensor

from torch_pmil.checks import check_noise, check_positive, check_tensor, check_whole
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, check_belief
from torch_pmil.model.compiled.plans import Comparison
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.kl import gaussian_cross_entropy, gaussian_kl, mean_kl
from torch_pmil.search.saturating_cost import expected_saturating_cost, saturating_cost
from torch_pmil.search.trajectory_loss import LossOptions, TrajectoryLoss

FAR = 50.0  # squared distance, for each entry, at which the cost of a sample is log 2


class TrajectoryKLLoss(TrajectoryLoss):
    r"""KL between demonstrated and predicted trajectories (Eq. 20), ``"loss_kl"``, in nats.

    .. math:: J_{\mathrm{IL}} = \sum_t \mathrm{KL}(p(x_t^{\exp}) \,\|\, p(x_t^\pi))

    Args:
        actor_network, dynamics, space: as in :class:`TrajectoryLoss`.
        demonstrated: demonstrated marginals at t = 1..T in the match space, with observation noise.
        noise_std: standard deviation of the observation noise added to the prediction too, in the
            units of the match space: one number, or one for each entry, (M,).
        options: ``reduction``, ``prediction`` and ``mean_prediction``, as there.

    Raises:
        ValueError: the demonstrated marginals or the noise are not in the match space or not
            finite, there is no step, the noise is negative, or the reduction is unknown.
        NotPositiveDefiniteError: a demonstrated covariance is not positive definite.

    Example:
        >>> from tensordict import TensorDict
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 1), torch.ones(1), torch.ones(1))
        >>> dynamics = GPDynamics(2, 1)
        >>> dynamics.set_data(torch.eye(2), torch.zeros(2, 1))
        >>> demonstrated = Gaussian(torch.zeros(5, 1).double(), torch.ones(5, 1, 1).double())
        >>> loss = TrajectoryKLLoss(policy, dynamics, space, demonstrated, noise_std=0.1)
        >>> start = {"mean": torch.zeros(1).double(), "var": torch.eye(1).double()}
        >>> loss(TensorDict({"observation": start}))["loss_kl"].shape
        torch.Size([])
    """

    out_keys = ["loss_kl"]
    label, unit = "KL", "nats"

    def __init__(
        self,
        actor_network: RBFPolicy,
        dynamics: GPDynamics,
        space: StateSpace,
        demonstrated: Gaussian,
        noise_std: float | Tensor,
        **options: Unpack[LossOptions],
    ) -> None:
        super().__init__(actor_network, dynamics, space, **options)
        names = space.match_space.names
        if demonstrated.dim != len(names):
            raise ValueError(
                f"demonstrated must have the {len(names)} entries {names}, got {demonstrated.dim}"
            )
        check_belief(demonstrated, "demonstrated")
        if not demonstrated.batch_shape[-1:].numel() or not demonstrated.batch_shape:
            raise ValueError(
                "demonstrated must be marginals at one step at least, mean (*batch, T, M), got "
                f"{tuple(demonstrated.mean.shape)}"
            )
        check_noise(noise_std, names, zero=True)
        self.noise_std = noise_std
        self.register_buffer("demonstrated_mean", demonstrated.mean.double())
        self.register_buffer("demonstrated_cov", demonstrated.cov.double())

    @property
    def horizon(self) -> int:
        """T, number of demonstrated steps after the start."""
        return self.demonstrated_mean.shape[-2]

    def step_loss_for_trust(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """KL of each step for each observed entry, (*batch, horizon)."""
        return self.per_step(initial, horizon) / self.space.match_space.dim

    def sample_costs(self, states: Tensor) -> Tensor:
        r"""Logarithmic distance of states from the demonstrated marginals, (N, \*batch, T).

        .. math:: \log\left(1 + \frac{d^2}{c M}\right), \qquad
            d^2 = (z - \mu^{\exp})^\top (\Sigma^{\exp})^{-1} (z - \mu^{\exp})

        Sampled trajectories that go elsewhere have a slope all the same, and do not drown the rest.
        """
        half_square = super().sample_costs(states)
        return torch.log1p(2 * half_square / (FAR * self.space.match_space.dim))

    def cross_entropy_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Cross-entropy of the prediction and the demonstrations at each step, (*batch, horizon).

        See :func:`~torch_pmil.search.kl.gaussian_cross_entropy`.
        """
        states = self.predict_states(initial, horizon)
        steps = states.batch_shape[-1]
        costs = self._by_kernels(states, self._cross_entropy(steps))
        if costs is None:
            costs = gaussian_cross_entropy(self._observe(states), self._demonstrated(steps))
        return costs

    def _observe(self, states: Gaussian) -> Gaussian:
        return super()._observe(states).add_noise(self.noise_std**2)

    def _costs(self, observed: Gaussian) -> Tensor:
        return gaussian_kl(self._demonstrated(observed.batch_shape[-1]), observed)

    def _mean_costs(self, observed: Tensor) -> Tensor:
        return mean_kl(self._demonstrated(observed.shape[-2]), observed)

    def _comparison(self, horizon: int) -> Comparison:
        demonstrated, match_space = self._demonstrated(horizon), self.space.match_space
        noise = torch.as_tensor(self.noise_std, dtype=torch.float64).expand(match_space.dim)
        return Comparison(
            match_space.augmentation,
            match_space.weights.double(),
            -demonstrated.mean,
            noise.square().diag(),
            demonstrated.cov,
        )

    def _comparison_of(self, method: object, horizon: int) -> Comparison | None:
        if method is TrajectoryKLLoss.cross_entropy_per_step:
            return self._cross_entropy(horizon)
        return super()._comparison_of(method, horizon)

    def _cross_entropy(self, horizon: int) -> Comparison:
        return replace(self._comparison(horizon), cross_entropy=True)

    def _demonstrated(self, horizon: int) -> Gaussian:
        mean, cov = self.demonstrated_mean, self.demonstrated_cov
        return Gaussian(mean[..., :horizon, :], cov[..., :horizon, :, :])


class ExpectedSaturatingCost(TrajectoryLoss):
    r"""PILCO's expected cost of not being at a target (Eq. 28), summed over the horizon: 0 to T.

    .. math:: \sum_t \mathbb E\left[1 - \exp\left(-\frac{d(z_t)^2}{2\sigma^2}\right)\right], \qquad
              d(z)^2 = (z - z_{\mathrm{target}})^\top W (z - z_{\mathrm{target}})

    The expectation is in closed form, over a Gaussian with the exact predicted moments of z in the
    match space, without observation noise. Eq. 28 itself has :math:`\sigma` = 2 and W = I. The
    entry is ``"loss_cost"``.

    Args:
        actor_network, dynamics, space: as in :class:`TrajectoryLoss`.
        target: the target, (M,), in the match space.
        width: distance :math:`\sigma` beyond which the cost saturates, in the unit of d.
        horizon: T, number of steps after the start.
        weight: W, (M, M), symmetric and positive semi-definite; the identity by default. Zeros
            ignore an entry.
        options: ``reduction``, ``prediction`` and ``mean_prediction``, as there.

    Raises:
        ValueError: shapes do not fit the match space, a number is not positive, W is indefinite, or
            the reduction is unknown.

    Example:
        >>> from tensordict import TensorDict
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

    out_keys = ["loss_cost"]
    label, unit = "cost", ""

    def __init__(
        self,
        actor_network: RBFPolicy,
        dynamics: GPDynamics,
        space: StateSpace,
        target: Tensor,
        width: float,
        horizon: int,
        weight: Tensor | None = None,
        **options: Unpack[LossOptions],
    ) -> None:
        super().__init__(actor_network, dynamics, space, **options)
        M = space.match_space.dim
        if target.shape != (M,):
            raise ValueError(
                f"target must have shape ({M},), the entries {space.match_space.names}, got "
                f"{tuple(target.shape)}"
            )
        check_tensor("target", target, (M,))
        check_positive("width", width)
        check_whole("horizon", horizon, 1)
        weight = torch.eye(M) if weight is None else weight
        check_tensor("weight", weight, (M, M))
        self._horizon = horizon
        self.register_buffer("target", target.double())
        self.register_buffer("to_widths", _root(weight.double()) / width)

    @property
    def horizon(self) -> int:
        """T, number of steps after the start."""
        return self._horizon

    def step_loss_for_trust(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Cost of each predicted marginal if its mean were the target, (*batch, horizon).

        The cost itself is high far from the target, however sure the prediction is.
        """
        observed = self.predict(initial, horizon)
        return self._score(Gaussian(self.target.expand_as(observed.mean), observed.cov))

    def _costs(self, observed: Gaussian) -> Tensor:
        residual = Gaussian(observed.mean - self.target, observed.cov)
        return expected_saturating_cost(residual.affine(self.to_widths))

    def _comparison(self, horizon: int) -> Comparison:
        match_space, to_widths = self.space.match_space, self.to_widths
        target = (-self.target @ to_widths.mT).expand(horizon, -1)
        weights = to_widths @ match_space.weights.to(to_widths)
        noise = torch.zeros_like(to_widths)
        return Comparison(match_space.augmentation, weights, target, noise, None)

    def _mean_costs(self, observed: Tensor) -> Tensor:
        return saturating_cost((observed - self.target) @ self.to_widths.mT)


def _root(weight: Tensor) -> Tensor:
    """Matrix R with R'R = W, for a W that may be singular."""
    values, vectors = torch.linalg.eigh(weight)
    if not torch.allclose(weight, weight.mT) or values[0] < -1e-12 * values[-1]:
        raise ValueError(
            f"weight must be symmetric and positive semi-definite, got {weight.tolist()}"
        )
    return values.clamp(min=0).sqrt()[:, None] * vectors.mT
