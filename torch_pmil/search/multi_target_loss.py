r"""One policy for many targets: the mean of the targets' KL sums (Eq. 31)."""

from __future__ import annotations

from typing import Unpack

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.rbf_policy import PolicyAtTargets, RBFPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.trajectory_loss import LossOptions


class MultiTargetKLLoss(TrajectoryKLLoss):
    r"""Mean over the targets of the KL to each target's demonstrations (Eq. 31), in nats.

    .. math::
        J_{\mathrm{MT}} = \frac1S \sum_{i=1}^S
        \mathrm{KL}(p(\tau_i^{\exp}) \,\|\, p(\tau^\pi | \eta_i))

    The last K inputs of the policy :math:`\pi(x, \eta)` are the target. From each start belief its
    trajectories are predicted for all S targets, in one batch; :meth:`rollout_loss` takes predicted
    beliefs, (\*batch, S, t, D).

    Args:
        actor_network, dynamics, space, noise_std, options: as in :class:`TrajectoryKLLoss`.
        demonstrated: demonstrated marginals of each target at t = 1..T, mean (S, T, M), with
            observation noise.
        targets: :math:`\eta_i`, (S, K).

    Raises:
        ValueError: shapes do not fit each other, or the reduction is unknown.
        TypeError: the policy is not an RBFPolicy.

    Example:
        >>> from torch_pmil import GPDynamics
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 2), torch.ones(1), torch.ones(2))
        >>> dynamics = GPDynamics(2, 1)
        >>> dynamics.set_data(torch.eye(2), torch.zeros(2, 1))
        >>> demonstrated = Gaussian(torch.zeros(4, 5, 1).double(), torch.ones(4, 5, 1, 1).double())
        >>> targets = torch.arange(4.0)[:, None]
        >>> loss = MultiTargetKLLoss(policy, dynamics, space, demonstrated, targets, noise_std=0.1)
        >>> loss.per_step(Gaussian(torch.zeros(1).double(), torch.eye(1).double())).shape
        torch.Size([5])
    """

    actor_network: RBFPolicy

    def __init__(
        self,
        actor_network: AnyPolicy,
        dynamics: ForwardModel,
        space: StateSpace,
        demonstrated: Gaussian,
        targets: Tensor,
        noise_std: float | Tensor,
        **options: Unpack[LossOptions],
    ) -> None:
        if not isinstance(actor_network, RBFPolicy):
            got = type(actor_network).__name__
            raise TypeError(f"a policy for several targets must be an RBFPolicy, got {got}")
        super().__init__(actor_network, dynamics, space, demonstrated, noise_std, **options)
        if targets.ndim != 2 or demonstrated.batch_shape[:-1] != targets.shape[:1]:
            raise ValueError(
                "targets must have shape (S, K) and the demonstrated marginals batch shape (S, T), "
                f"got targets {tuple(targets.shape)} and demonstrated marginals of batch shape "
                f"{tuple(demonstrated.batch_shape)}"
            )
        check_tensor("targets", targets, ("S", "K"))
        features, inputs = space.feature_names, len(actor_network.scale)
        if inputs != len(features) + targets.shape[1]:
            raise ValueError(
                f"the policy must see {', '.join(features)} and a target of {targets.shape[1]}, "
                f"got one of {inputs} inputs"
            )
        self.register_buffer("targets", targets.double())

    def begin(self, initial: Gaussian) -> tuple[Gaussian, PolicyAtTargets]:
        """Each belief (*batch, D) once for every target, (*batch, S, D), and the policy there."""
        batch, S = initial.batch_shape, len(self.targets)
        mean, cov = initial.mean[..., None, :], initial.cov[..., None, :, :]
        start = Gaussian(mean.expand(*batch, S, -1), cov.expand(*batch, S, -1, -1))
        return start, PolicyAtTargets(self.actor_network, self.targets.repeat(batch.numel(), 1))

    def policy_inputs(self, states: Tensor) -> Tensor:
        """Features of states (*batch, S, t, D), with the targets."""
        features = super().policy_inputs(states)
        return torch.cat([features, self.targets[:, None].expand(*features.shape[:-1], -1)], -1)

    def per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """KL of each predicted marginal, averaged over the targets, (*batch, horizon)."""
        return super().per_step(initial, horizon).mean(-2)

    def cross_entropy_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Cross-entropy of each step, averaged over the targets, (*batch, horizon)."""
        return super().cross_entropy_per_step(initial, horizon).mean(-2)

    def mean_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """KL of the model's mean by step, averaged over the targets, (*batch, horizon)."""
        return super().mean_per_step(initial, horizon).mean(-2)

    def spread(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """That of the least sure target, (*batch, horizon): all predictions must be trusted."""
        return super().spread(initial, horizon).amax(-2)

    def step_loss_for_trust(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """Largest KL of all targets by step and observed entry, (*batch, horizon).

        All predictions must be trusted.
        """
        return super().per_step(initial, horizon).amax(-2) / self.space.match_space.dim
