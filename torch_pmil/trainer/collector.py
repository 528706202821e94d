"""The actor that runs on the robot, and the collector of its rollouts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from torch_pmil.control.exploration import Motion
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.rollouts import as_executed


class RobotActor(torch.nn.Module):
    """Actor on the robot: the exploration until the first search, then the policy.

    Args:
        policy: function of the features of the state.
        space: the robot's state space, which gives the features.
        motion: of the exploration.
    """

    def __init__(self, policy: AnyPolicy, space: StateSpace, motion: Motion) -> None:
        super().__init__()
        self.policy, self.space, self.motion = policy, space, motion
        self.exploring = True

    @torch.no_grad()
    def forward(self, observation: Tensor, target: Tensor | None = None) -> Tensor:
        """Actions (*batch, F) at states (*batch, D) and, if given, targets (*batch, K)."""
        if self.exploring:
            return self.motion(observation)
        features = self.space.features(observation)
        return self.policy(features if target is None else torch.cat([features, target], -1))


class RolloutCollector(Collector):
    """TorchRL's collector of endless batches, each one rollout of each robot.

    A rollout that the robot ends early is shorter, and may be empty; ``cut_short`` then says why,
    and is "" for a complete one. The state of the collector holds the latest batch, with which it
    begins again once the state is loaded: a resumed run learns from the motion before a checkpoint.

    Args:
        env: the robot.
        policy: the module that the robot executes.
        actor: the actor inside the policy.
        steps: of the next rollouts of each robot; may be changed between them.
        tries: whether the robot may be reset when the collector is made, to try out the policy.
    """

    _latest: TensorDictBase | None = None
    _repeated = False

    def __init__(
        self, env: EnvBase, policy: TensorDictModule, actor: RobotActor, steps: int, tries: bool
    ) -> None:
        self.steps, self.cut_short = steps, ""
        self._tries, self._physical = tries, env.physical
        super().__init__(
            env,
            policy,
            frames_per_batch=steps * env.batch_size.numel(),
            total_frames=-1,
            reset_at_each_iter=True,
            auto_register_policy_transforms=False,
            track_traj_ids=False,  # they would count resumptions too
        )
        self._executed, self._actor = policy, actor

    def rollout(self) -> TensorDictBase:
        """Next batch, (*robots, up to ``steps``)."""
        if self._actor.exploring:
            self._actor.motion.begin()
        rollout = as_executed(self.env.rollout(self.steps, self._executed))
        self.cut_short = self.env.cut_short
        return rollout

    def shutdown(
        self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True
    ) -> None:
        """End the collection; a physical robot stays open for whoever opened it."""
        super().shutdown(timeout, close_env and not self._physical, raise_on_error)

    def begin_with(self, first: TensorDictBase) -> None:
        """Yield a motion that was made before, as the first batch."""
        self._repeated, self._latest = True, first

    def _make_carrier(self) -> None:
        """Make the state on which TorchRL tries out the policy, with or without a motion."""
        if self._tries:
            super()._make_carrier()
        else:
            self._carrier = self.env.fake_tensordict()

    def iterator(self) -> Iterator[TensorDictBase]:
        """Yield the batch of a loaded state, then new ones."""
        if self._repeated:
            self._repeated = False
            yield self._latest
        for self._latest in super().iterator():
            yield self._latest

    def state_dict(self) -> dict[str, object]:
        """State of TorchRL's collector, with the latest batch and the environment's state."""
        latest = None
        if self._latest is not None:
            latest = {
                "entries": self._latest.to_dict(),
                "shape": list(self._latest.shape),
                "cut_short": self.cut_short,
            }
        return {**super().state_dict(), "env_state_dict": self.env.state_dict(), "latest": latest}

    def load_state_dict(self, state_dict: Mapping[str, Any], **kwargs: Any) -> None:
        """Load a saved state."""
        state = dict(state_dict)
        latest = state.pop("latest")
        super().load_state_dict(state, **kwargs)
        self._repeated, self._latest, self.cut_short = latest is not None, None, ""
        if latest is not None:
            self._latest = TensorDict(latest["entries"], latest["shape"])
            self.cut_short = latest["cut_short"]
