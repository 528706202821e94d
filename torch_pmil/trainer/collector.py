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

from torch_pmil.control.exploration import Exploration, Motion
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace


class RobotActor(torch.nn.Module):
    """Actor on the robot: the exploration until the first search, then the policy.

    Args:
        policy: the policy, a function of the features of the state.
        space: the robot's state space, which gives the features.
        motion: the motion of the exploration.
    """

    def __init__(self, policy: RBFPolicy, space: StateSpace, motion: Motion) -> None:
        super().__init__()
        self.policy, self.space, self.motion = policy, space, motion
        self.exploring = True

    @torch.no_grad()
    def forward(self, observation: Tensor, target: Tensor | None = None) -> Tensor:
        """Torques (*batch, F), N·m, at states (*batch, D) and, if any, for targets (*batch, K)."""
        if self.exploring:
            return self.motion(observation)
        features = self.space.features(observation)
        return self.policy(features if target is None else torch.cat([features, target], -1))


class RolloutCollector(Collector):
    """TorchRL's collector of one rollout of each robot a batch, without end.

    The first batch holds all rollouts of the exploration in a row.

    The collector's state holds the batch that it handed out last: with a loaded state it begins
    with that one. A checkpoint that is written as soon as the robot has moved thus holds the
    motion, and a resumed loop learns from it as the first one did.

    Args:
        env: the robot.
        policy: the module that the robot executes.
        actor: the actor inside the policy.
        exploration: rollouts of the first batch, and their steps.
        horizon: steps of the other rollouts of each robot.
    """

    _latest: TensorDictBase | None = None
    _repeated = False

    def __init__(
        self,
        env: EnvBase,
        policy: TensorDictModule,
        actor: RobotActor,
        exploration: Exploration,
        horizon: int,
    ) -> None:
        super().__init__(
            env,
            policy,
            frames_per_batch=horizon * env.batch_size.numel(),
            total_frames=-1,
            reset_at_each_iter=True,
            auto_register_policy_transforms=False,
            track_traj_ids=False,  # they would count resumptions too
        )
        self._executed, self._actor, self._exploration = policy, actor, exploration

    def rollout(self) -> TensorDictBase:
        """Next batch, (*robots, steps)."""
        if self._frames:
            return super().rollout()
        rollouts = []
        for _ in range(self._exploration.rollouts):
            self._actor.motion.begin()
            rollouts.append(self.env.rollout(self._exploration.steps, self._executed))
        return torch.cat(rollouts, -1)

    def iterator(self) -> Iterator[TensorDictBase]:
        """Yield the batch of a loaded state, then new ones."""
        if self._repeated:
            self._repeated = False
            yield self._latest
        for self._latest in super().iterator():
            yield self._latest

    def state_dict(self) -> dict[str, object]:
        """State of TorchRL's collector, with the environment's state and the latest batch.

        TorchRL leaves out what a plain environment remembers.
        """
        latest = None
        if self._latest is not None:
            latest = {"entries": self._latest.to_dict(), "shape": list(self._latest.shape)}
        return {**super().state_dict(), "env_state_dict": self.env.state_dict(), "latest": latest}

    def load_state_dict(self, state_dict: Mapping[str, Any], **kwargs: Any) -> None:
        """Restore what :meth:`state_dict` gave."""
        state = dict(state_dict)
        latest = state.pop("latest")
        super().load_state_dict(state, **kwargs)
        self._repeated = latest is not None
        self._latest = TensorDict(latest["entries"], latest["shape"]) if self._repeated else None
