"""What runs on the robot, and how its rollouts are collected."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.collectors import Collector

from torch_pmil.policy import RBFPolicy
from torch_pmil.state_space import StateSpace


class RobotActor(torch.nn.Module):
    """What the robot executes: random torques until the first search, then the policy.

    Args:
        policy: sees the features of the state.
        space: gives those.
        random_torque: largest random torque, as a fraction of the limits.
        generator: of the random torques.
    """

    def __init__(self, policy: RBFPolicy, space: StateSpace, random_torque: float, generator: torch.Generator) -> None:
        super().__init__()
        self.policy, self.space, self.random_torque, self.generator = policy, space, random_torque, generator
        self.exploring = True

    @torch.no_grad()
    def forward(self, observation: Tensor) -> Tensor:
        """Torques (*batch, F), N·m, for states (*batch, D)."""
        if not self.exploring:
            return self.policy(self.space.features(observation))
        shape = (*observation.shape[:-1], len(self.policy.u_max))
        uniform = 2 * torch.rand(shape, dtype=torch.float64, generator=self.generator) - 1
        return self.random_torque * self.policy.u_max * uniform


class RolloutCollector(Collector):
    """TorchRL's collector, whose state holds the batch that it handed out last: with a loaded state it begins with that one.

    A checkpoint that is written as soon as the robot has moved thus holds the motion, and a resumed loop learns from it as the
    first one did.
    """

    _latest: TensorDictBase | None = None
    _repeated = False

    def iterator(self) -> Iterator[TensorDictBase]:
        """The batch of a loaded state, then new ones."""
        if self._repeated:
            self._repeated = False
            yield self._latest
        for self._latest in super().iterator():
            yield self._latest

    def state_dict(self) -> dict[str, object]:
        """TorchRL's, which leaves out what a plain environment remembers, with that and the latest batch."""
        latest = None if self._latest is None else {"entries": self._latest.to_dict(), "shape": list(self._latest.shape)}
        return {**super().state_dict(), "env_state_dict": self.env.state_dict(), "latest": latest}

    def load_state_dict(self, state_dict: Mapping[str, object], **kwargs) -> None:
        """Restore what :meth:`state_dict` gave."""
        state = dict(state_dict)
        latest = state.pop("latest")
        super().load_state_dict(state, **kwargs)
        self._repeated = latest is not None
        self._latest = TensorDict(latest["entries"], latest["shape"]) if self._repeated else None


def states_of(rollout: TensorDictBase) -> Tensor:
    """States x_0..x_T of rollouts (*batch, T), as the robot's sensors say: (*batch, T + 1, D)."""
    return _course_of(rollout, "observation")


def true_states_of(rollout: TensorDictBase) -> Tensor:
    """States x_0..x_T of rollouts (*batch, T), also where the robot's sensors are noisy: (*batch, T + 1, D)."""
    return _course_of(rollout, "state" if "state" in set(rollout.keys()) else "observation")


def _course_of(rollout: TensorDictBase, key: str) -> Tensor:
    return torch.cat([rollout[key][..., :1, :], rollout["next", key]], -2)
