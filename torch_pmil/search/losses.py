"""The loss of imitation: the KL between demonstrated and predicted trajectories (Eq. 20)."""

from __future__ import annotations

from dataclasses import replace
from typing import Unpack

import torch
from torch import Tensor

from torch_pmil.checks import check_noise
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, check_belief
from torch_pmil.model.compiled.plans import Comparison
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.kl import gaussian_cross_entropy, gaussian_kl, mean_kl
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
        >>> from torch_pmil import GPDynamics, RBFPolicy
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
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
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
        r"""Logarithmic distances (N, \*batch, T) of trajectories from the demonstrated marginals.

        .. math:: \log\left(1 + \frac{d^2}{c M}\right), \qquad
            d^2 = (z - \mu^{\exp})^\top (\Sigma^{\exp})^{-1} (z - \mu^{\exp})

        Sampled trajectories that go elsewhere have a slope all the same, and do not drown the rest.
        """
        half_square = super().sample_costs(states)
        return torch.log1p(2 * half_square / (FAR * self.space.match_space.dim))

    def typical_cost(self, states: Tensor) -> Tensor:
        """One: a logarithm is of that size, however far the states are."""
        return torch.ones_like(states[0, ..., 0, 0]).mean()

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
