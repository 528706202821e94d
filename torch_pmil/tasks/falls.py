"""Where a robot has fallen: its environment terminates, far from all that was demonstrated."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs.robot import RobotEnv

FAR = 1.0  # distance from the demonstrated range, in that range


def far_off(seen: Tensor, shown: Tensor, noise_std: float | Tensor) -> Tensor:
    """Whether ``seen`` (*batch, M) is farther from the range of ``shown`` than its size, (*batch,).

    Args:
        seen: what is compared with the demonstrations.
        shown: the demonstrations (*N, M).
        noise_std: of each entry, which a range has at least.

    Example:
        >>> shown = torch.tensor([[0.0], [1.0]])
        >>> far_off(torch.tensor([[1.9], [-1.5]]), shown, 0.0)
        tensor([False,  True])
    """
    low, high = shown.flatten(0, -2).amin(0), shown.flatten(0, -2).amax(0)
    beyond = torch.maximum(low - seen, seen - high) / (high - low + noise_std)
    return beyond.amax(-1) > FAR


@dataclass(frozen=True, eq=False)
class FallGuard:
    """Ends a motion where its environment terminates far from what was demonstrated.

    What follows is seldom smooth, as where a pole lies on a rail, and spoils the model. An
    environment may also terminate at the goal. Demonstrations show that, so the motion goes on.

    Args:
        env: the robot.
        space: its state space.
        shown: the demonstrations (N, T + 1, M).
        noise_std: of what is compared with them.
    """

    env: RobotEnv
    space: StateSpace
    shown: Tensor
    noise_std: float | Tensor

    def __call__(self, states: Tensor) -> str:
        """Why the motion must end at states (*batch, D); "" if it goes on."""
        if not self.env.terminated:
            return ""
        fell = far_off(self.space.observe(states), self.shown, self.noise_std).any()
        return "the environment terminates, far from what was demonstrated" if fell else ""
