"""What a peer of our method is: a learner of a policy from state-only demonstrations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.tasks.task import Task


class Peer(ABC):
    """A learner that sees what ours sees: the demonstrated states, and its own motion.

    :func:`~reproduction.baselines.peer_run.peer_run` gives it experience, and measures it.

    Args:
        experiment: what to learn.
        seed: of all its random numbers; same seed, same learner up to rounding.

    ``label`` names the method in figures, ``name`` in folders. ``rollouts`` are its own so far.
    ``confirmations`` successes of own rollouts in a row end a run, as a promise does ours; None for
    none.
    """

    label: ClassVar[str]
    name: ClassVar[str]
    confirmations: ClassVar[int | None] = None

    def __init__(self, experiment: Task, seed: int) -> None:
        self.experiment = experiment
        self.generator = torch.Generator().manual_seed(seed)
        self.rollouts: list[TensorDictBase] = []
        self._fitted = 0  # transitions of the last fit

    def add(self, rollout: TensorDictBase) -> None:
        """Add an own rollout (T,): observation, action, and (next, observation)."""
        self.rollouts.append(rollout.select("observation", "action", ("next", "observation")))

    @abstractmethod
    def fit(self) -> None:
        """Learn from all rollouts so far."""

    @abstractmethod
    def act(self, step: int, states: Tensor) -> Tensor:
        """Actions (*batch, F), within their limits, at states (*batch, D).

        It is called for the steps 0, 1, ..., T - 1, one after the other; 0 begins at new starts.
        """

    def explore(self, step: int, states: Tensor) -> Tensor:
        """Actions of the own rollouts, from which it learns: those of :meth:`act`, or around them.

        The arguments are those of :meth:`act`.
        """
        return self.act(step, states)

    def steps_of_fit(self, least: int) -> int:
        """Steps of a fit that begins: as many as transitions are new, but ``least`` at least."""
        count = sum(map(len, self.rollouts))
        new, self._fitted = count - self._fitted, count
        return max(least, new)

    @property
    def transitions(self) -> tuple[Tensor, Tensor, Tensor]:
        """States (n, D), actions (n, F) and next states (n, D) of all rollouts so far."""
        keys = "observation", "action", ("next", "observation")
        states, actions, following = (
            torch.cat([rollout.get(key) for rollout in self.rollouts]) for key in keys
        )
        return states, actions, following

    @property
    def demonstrated_states(self) -> Tensor:
        """States (N, T + 1, D) that the demonstrations show."""
        positions = self.experiment.demonstrations.positions
        return self.experiment.demonstrated_states.unflatten(0, positions.shape[:2])

    @property
    def demonstrated_transitions(self) -> tuple[Tensor, Tensor]:
        """States and next states (N T, D) of the demonstrations, without actions."""
        return consecutive(self.demonstrated_states)


def consecutive(trajectories: Tensor) -> tuple[Tensor, Tensor]:
    """Entries of trajectories (N, T + 1, D) and those a step later, both (N T, D).

    Example:
        >>> now, later = consecutive(torch.arange(6.0).reshape(2, 3, 1))
        >>> now.flatten().tolist(), later.flatten().tolist()
        ([0.0, 1.0, 3.0, 4.0], [1.0, 2.0, 4.0, 5.0])
    """
    return trajectories[:, :-1].flatten(0, 1), trajectories[:, 1:].flatten(0, 1)
