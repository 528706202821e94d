"""A world model as TorchRL environment of beliefs: the counterpart of its ``ImaginedEnv``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.model_based import ModelBasedEnvBase

from torch_pmil.torchrl_interop import keys


class ImaginedEnv(ModelBasedEnvBase):
    r"""Rollouts of beliefs under a world model, in float64, with gradients.

    A step reads ``("observation", "mean" | "var")`` and ``("action", "mean" | "var" |
    "cross_covariance")``, and gives the next belief. An action with a ``mean`` only is certain. The
    reward is zero (the cost is a loss of the rollout), and an episode never ends by itself.

    ``reset`` starts at the belief or the certain ``"observation"`` that it is given, or else at an
    observation drawn from the base environment's specification.

    Args:
        world_model_module: writes the ``mean`` and the ``var`` of the next observation.
        base_env: the real environment, whose ``"observation"`` (*batch, D) and action (*batch, F)
            give the dimensions.
        batch_size: of the rollouts; that of the base environment, but at least (1,), if None. With
            () any batch is taken.
        next_observation_key: the key under which the world model writes ``"mean"`` and ``"var"``.

    Raises:
        TypeError: ``base_env`` is not an environment.
        ValueError: it has no single action of real numbers, or no vector ``"observation"``.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> from torch_pmil.torchrl_interop import GPWorldModel
        >>> robot = DoublePendulumEnv(num_envs=3, seed=0)
        >>> model = GPWorldModel(obs_dim=4, action_dim=2)
        >>> _ = model.fit(robot.rollout(5))
        >>> ImaginedEnv(model, robot).rollout(2)["next", "observation", "var"].shape
        torch.Size([3, 2, 4, 4])
    """

    def __init__(
        self,
        world_model_module: TensorDictModuleBase,
        base_env: EnvBase,
        batch_size: Sequence[int] | None = None,
        next_observation_key: NestedKey = keys.NEXT_OBSERVATION,
    ) -> None:
        if not isinstance(base_env, EnvBase):
            raise TypeError(f"base_env must be an EnvBase, got {type(base_env).__name__}")
        observation, action = _observation_spec(base_env), _action_spec(base_env)
        if batch_size is None:
            batch_size = base_env.batch_size or (1,)
        if not all(isinstance(size, int) and size > 0 for size in batch_size):
            raise ValueError(f"batch_size must hold positive numbers, got {tuple(batch_size)}")
        super().__init__(
            world_model_module,
            device=base_env.device,
            batch_size=torch.Size(batch_size),
            allow_done_after_reset=True,
        )
        self.next_observation_key = next_observation_key
        self.dim = observation.shape[-1]
        self._start_spec = observation.expand(*self.batch_size, self.dim)
        self._make_specs(action)

    def _make_specs(self, action: TensorSpec) -> None:
        batch, D, F = self.batch_size, self.dim, action.shape[-1]
        real = {"dtype": torch.float64, "device": self.device}
        belief = Composite(
            mean=Unbounded((*batch, D), **real), var=Unbounded((*batch, D, D), **real), shape=batch
        )
        self.observation_spec = Composite(observation=belief, shape=batch)
        self.action_spec = Composite(
            action=Composite(mean=action.expand(*batch, F), shape=batch), shape=batch
        )
        self.reward_spec = Unbounded((*batch, 1), **real)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        given = TensorDict(batch_size=self.batch_size) if tensordict is None else tensordict
        belief = keys.lookup_belief(given, keys.STATE_BELIEF, self.dim)
        if belief is not None:
            return self._start(given.batch_size, belief.mean, belief.cov)
        certain = keys.lookup(given, keys.OBSERVATION, (self.dim,))
        certain = self._start_spec.rand().double() if certain is None else certain
        return self._start(given.batch_size, certain, certain.new_zeros(*certain.shape, self.dim))

    def _start(self, batch: torch.Size, mean: Tensor, var: Tensor) -> TensorDictBase:
        D = self.dim
        observation = {"mean": mean.expand(*batch, D), "var": var.expand(*batch, D, D)}
        return TensorDict({"observation": observation}, batch_size=batch, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        batch = tensordict.batch_size
        written = self.world_model(_with_whole_action(tensordict, self.dim))
        following = written.get(self.next_observation_key)
        zero = torch.zeros(*batch, 1, dtype=torch.float64, device=self.device)
        outcome = {"reward": zero, "done": zero.bool()}
        result = {"observation": following.select("mean", "var")} | outcome
        return TensorDict(result, batch_size=batch, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        """Nothing to do: the environment draws nothing."""


def _with_whole_action(tensordict: TensorDictBase, dim: int) -> TensorDictBase:
    """A copy whose action has ``var`` and ``cross_covariance``, zero where they are missing."""
    whole = tensordict.clone(recurse=False)
    mean, action = whole.get(keys.ACTION_BELIEF[0]), whole.get(keys.ACTION)
    for key, rows in (("var", mean.shape[-1]), ("cross_covariance", dim)):
        if action.get(key, None) is None:
            action.set(key, mean.new_zeros(*mean.shape[:-1], rows, mean.shape[-1]))
    return whole


def _observation_spec(base_env: EnvBase) -> TensorSpec:
    """Specification of one robot's observation (D,)."""
    specs = base_env.observation_spec_unbatched
    spec = specs.get(keys.OBSERVATION, None)
    if spec is None or len(spec.shape) != 1:
        raise ValueError(f'base_env must have a vector "observation", got {specs}')
    return spec


def _action_spec(base_env: EnvBase) -> TensorSpec:
    """Specification of one robot's action (F,), in float64."""
    spec = base_env.action_spec_unbatched
    real = isinstance(spec, (Bounded, Unbounded)) and spec.dtype.is_floating_point
    if not real or len(spec.shape) != 1:
        message = f"base_env must have one action that is a vector of real numbers, got {spec}"
        raise ValueError(message)
    return spec.to(torch.float64)
