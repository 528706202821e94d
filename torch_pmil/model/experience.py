"""The robot's transitions in a TorchRL replay buffer, and the GP's training data from them."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyMemmapStorage, TensorDictReplayBuffer

from torch_pmil.checks import check_finite_entries, check_whole
from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.forward_model import ForwardModel, Targets, known_part

FEWEST_TRANSITIONS = 2  # for a model
KEYS = ("observation", "action", ("next", "observation"))


class Experience:
    """Transitions (x_t, u_t, x_{t+1}) of the robot, memory-mapped, in the order of their recording.

    Args:
        capacity: largest number of transitions, a whole number of at least 1.

    Example:
        >>> experience = Experience(capacity=100)
        >>> len(experience)
        0
    """

    def __init__(self, capacity: int) -> None:
        check_whole("capacity", capacity, 1)
        storage = LazyMemmapStorage(capacity)
        self.buffer = TensorDictReplayBuffer(storage=storage, batch_size=capacity)
        self.capacity = capacity

    def __len__(self) -> int:
        return len(self.buffer)

    def extend(self, transitions: TensorDictBase) -> None:
        """Add transitions with the keys observation, action and (next, observation), of any batch.

        Raises:
            KeyError: one of the keys is missing.
            ValueError: an entry is not finite or of another shape, or the buffer is full.
        """
        present = transitions.keys(include_nested=True)
        for key in KEYS:
            if key not in present:
                raise KeyError(
                    f"transitions must have {', '.join(map(str, KEYS))}, got "
                    f"{sorted(present, key=str)}"
                )
        if not transitions.batch_size.numel():  # which TensorDict does not reshape
            return
        flat = transitions.select(*KEYS).detach().reshape(-1)
        self._check_shapes(flat)
        for key in KEYS:
            check_finite_entries(f"transitions' {key}", flat[key])
        if len(self) + len(flat) > self.capacity:
            raise ValueError(
                f"experience holds at most {self.capacity} transitions, got {len(self) + len(flat)}"
            )
        with torchrl_warnings_alone():
            self.buffer.extend(TensorDict(flat.to_dict(), batch_size=flat.batch_size))

    def _check_shapes(self, flat: TensorDictBase) -> None:
        like = self.transitions if len(self) else flat
        states, actions = like["observation"].shape[1:], like["action"].shape[1:]
        for key, shape in zip(KEYS, (states, actions, states), strict=True):
            if flat[key].shape[1:] != shape:
                raise ValueError(
                    f"transitions must have {key} of shape {tuple(shape)} each, got "
                    f"{tuple(flat[key].shape[1:])}"
                )

    def state_dict(self) -> dict[str, object]:
        """All transitions, for a checkpoint."""
        return {
            "count": len(self),
            "transitions": self.transitions.select(*KEYS).to_dict() if len(self) else {},
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Replace all transitions by those of a checkpoint.

        The capacity grows by their number, since they may come from another run.
        """
        self.capacity += state_dict["count"]
        storage = LazyMemmapStorage(self.capacity)
        self.buffer = TensorDictReplayBuffer(storage=storage, batch_size=self.capacity)
        if state_dict["count"]:
            self.extend(TensorDict(state_dict["transitions"], batch_size=[state_dict["count"]]))

    @property
    def transitions(self) -> TensorDictBase:
        """All transitions, (n,), in the order of their recording."""
        return self.buffer[:]

    def training_data(self, space: StateSpace, targets: Targets) -> tuple[Tensor, Tensor]:
        """GP inputs [features of x_t, u_t] (n, D' + F) and targets (n, E).

        Args:
            space: the robot's state space.
            targets: what a model learns, as in :class:`ForwardModel`.

        Raises:
            ValueError: there is no transition, or shapes do not fit.
        """
        return gp_data(*self._parts(), space, targets)

    def data_for(self, dynamics: ForwardModel, space: StateSpace) -> tuple[Tensor, Tensor]:
        """:meth:`training_data` of a model, whose known part first learns from the same data."""
        states, actions, successors = self._parts()
        dynamics.fit_known_part(states, successors)
        return gp_data(states, actions, successors, space, dynamics.targets)

    def _parts(self) -> tuple[Tensor, Tensor, Tensor]:
        """States (n, D), actions (n, F) and successors (n, D)."""
        if not len(self):
            raise ValueError("experience must hold a transition at least, got none")
        transitions = self.transitions
        successors = transitions["next", "observation"]
        return transitions["observation"], transitions["action"], successors


def gp_data(
    states: Tensor, actions: Tensor, successors: Tensor, space: StateSpace, targets: Targets
) -> tuple[Tensor, Tensor]:
    """Model inputs [features of x_t, u_t] (*batch, D' + F) and targets (*batch, E) of transitions.

    States x_t and successors x_{t+1} are (*batch, D), actions u_t (*batch, F).
    """
    if not states.shape[:-1] == actions.shape[:-1] == successors.shape[:-1]:
        shapes = f"{tuple(states.shape)}, {tuple(actions.shape)} and {tuple(successors.shape)}"
        raise ValueError(f"states, actions and successors must be as many, got shapes {shapes}")
    inputs = torch.cat([space.features(states), actions], -1)
    known = known_part(targets, states.shape[-1])
    return inputs, known.targets(states, actions, successors)


@contextmanager
def torchrl_warnings_alone() -> Iterator[None]:
    """Within, TorchRL logs only warnings, unless ``RL_LOGGING_LEVEL`` asks for more."""
    logger = logging.getLogger("torchrl")
    before = logger.level
    if "RL_LOGGING_LEVEL" not in os.environ:
        logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(before)
