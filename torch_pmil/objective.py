"""The imitation objective as a TorchRL loss: KL between demonstrated and predicted trajectories (Eq. 20)."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.objectives import LossModule

from torch_pmil.dynamics import GPDynamics
from torch_pmil.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.kl import gaussian_kl, mean_kl
from torch_pmil.policy import RBFPolicy
from torch_pmil.rollout import PredictionError, predict_mean_trajectory, predict_trajectory
from torch_pmil.state_space import StateSpace


class TrajectoryKLLoss(LossModule):
    r""":math:`J_{\mathrm{IL}} = \sum_t \mathrm{KL}(p(x_t^{\exp}) \,\|\, p(x_t^\pi))` (Eq. 20), in nats, for a belief over the start state.

    Reads ``("observation", "mean")`` (D,) and ``("observation", "var")`` (D, D), the belief p(x_0), and writes ``"loss_kl"``.

    Args:
        actor_network: the policy, whose parameters are learned.
        dynamics: the forward model, constant here.
        space: the robot's state space.
        expert: demonstrated marginals at t = 1..T in the match space, observation noise included.
        noise_std: observation noise added to the prediction too, in the unit of the match space.

    Raises:
        ValueError: the expert is not in the match space.
    """

    @dataclass
    class _AcceptedKeys:
        mean: NestedKey = ("observation", "mean")
        var: NestedKey = ("observation", "var")

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_kl"]

    def __init__(self, actor_network: RBFPolicy, dynamics: GPDynamics, space: StateSpace, expert: Gaussian, noise_std: float) -> None:
        super().__init__()
        if expert.dim != space.match.dim:
            raise ValueError(f"expert must have the {space.match.dim} entries {space.match.names}, got {expert.dim}")
        self.actor_network = actor_network
        self.dynamics = dynamics
        self.space = space
        self.noise_std = noise_std
        self.register_buffer("expert_mean", expert.mean)
        self.register_buffer("expert_cov", expert.cov)

    @property
    def in_keys(self) -> list[NestedKey]:
        """Keys of the belief over the start state."""
        return [self.tensor_keys.mean, self.tensor_keys.var]

    @property
    def horizon(self) -> int:
        """T, number of demonstrated steps after the start."""
        return self.expert_mean.shape[-2]

    def predict(self, initial: Gaussian, horizon: int | None = None) -> Gaussian:
        """Predicted observations at t = 1..horizon, noise included: mean (*batch, horizon, M)."""
        states = predict_trajectory(initial, self.actor_network, self.dynamics, self.space, horizon or self.horizon)
        return self.space.match.belief(states).add_noise(self.noise_std**2)

    def per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """KL of each marginal up to a horizon (the summands of Eq. 20), (*batch, horizon). Raises PredictionError."""
        predicted = self.predict(initial, horizon)
        try:
            return gaussian_kl(self._expert(horizon), predicted)
        except NotPositiveDefiniteError as error:
            step = error.element[-1] + 1
            raise PredictionError(f"comparison of step {step} of {predicted.batch_shape[-1]} failed: {error}", step) from error

    def mean_per_step(self, initial: Gaussian, horizon: int | None = None) -> Tensor:
        """The same for the model's mean alone, weighed by the expert's covariance: cheap, and no local optimum of wide predictions."""
        states = predict_mean_trajectory(initial.mean, self.actor_network, self.dynamics, self.space, horizon or self.horizon)
        return mean_kl(self._expert(horizon), self.space.match(states))

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Loss of the whole horizon at the belief in ``tensordict``."""
        initial = Gaussian(tensordict.get(self.tensor_keys.mean), tensordict.get(self.tensor_keys.var))
        return TensorDict({"loss_kl": self.per_step(initial).sum(-1).mean()})

    def _expert(self, horizon: int | None) -> Gaussian:
        return Gaussian(self.expert_mean, self.expert_cov)[:horizon]

    def _forward_value_estimator_keys(self, **kwargs) -> None:
        """The loss has no value estimator."""
