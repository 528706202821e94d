"""TorchRL's rollouts, and the states and pictures in them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor


def states_of(rollout: TensorDictBase) -> Tensor:
    """Measured states x_0..x_T of rollouts (*batch, T): (*batch, T + 1, D)."""
    return torch.cat([rollout["observation"][..., :1, :], rollout["next", "observation"]], -2)


def rollout_of(states: Tensor) -> TensorDict:
    """Rollouts (*batch, T) that hold only states x_0..x_T, (*batch, T + 1, D).

    :func:`states_of` returns the states.

    Example:
        >>> states_of(rollout_of(torch.zeros(7, 26, 4))).shape
        torch.Size([7, 26, 4])
    """
    batch = (*states.shape[:-2], states.shape[-2] - 1)
    return TensorDict(
        {"observation": states[..., :-1, :], "next": {"observation": states[..., 1:, :]}}, batch
    )


def as_executed(rollout: TensorDictBase) -> TensorDictBase:
    """A rollout (*batch, T) without a step that was not measured, with the actions as sent.

    A robot whose reading failed reports that in ``("next", "measured")`` and ends the rollout; one
    that changes actions reports them in ``("next", "sent")``.

    Example:
        >>> rollout = rollout_of(torch.zeros(6, 4))
        >>> rollout["action"] = torch.ones(5, 1)
        >>> rollout["next", "sent"] = torch.zeros(5, 1)
        >>> rollout["next", "measured"] = (torch.arange(5) < 4)[:, None]
        >>> executed = as_executed(rollout)
        >>> executed.shape, executed["action"].sum()
        (torch.Size([4]), tensor(0.))
    """
    shown = rollout["next"].keys()
    if "measured" in shown:
        measured = rollout["next", "measured"].squeeze(-1)
        rollout = rollout[..., measured.flatten(0, -2).all(0) if measured.ndim > 1 else measured]
    if "sent" in shown:
        rollout = rollout.copy()
        rollout["action"] = rollout["next", "sent"]
    return rollout


def pictures_of(rollout: TensorDictBase) -> Iterator[np.ndarray]:
    """T + 1 pictures (height, width, 3), uint8, of a rollout (T,) with ``from_pixels=True``."""
    pictures = itertools.chain(rollout["pixels"][:1], rollout["next", "pixels"])
    return (picture.numpy() for picture in pictures)


def without_sensor_noise(rollout: TensorDictBase) -> TensorDictBase:
    """The rollouts as exact sensors would show them."""
    if "state" not in set(rollout.keys()):
        return rollout
    true = rollout.copy()
    true["observation"], true["next", "observation"] = rollout["state"], rollout["next", "state"]
    return true


def of_states(error: Callable[[Tensor], Tensor]) -> Callable[[TensorDictBase], Tensor]:
    """An error (*batch) of rollouts (*batch, T), from an error of x_0..x_T, (*batch, T + 1, D).

    Example:
        >>> last = of_states(lambda states: states[..., -1, :].norm(dim=-1))
        >>> last(rollout_of(torch.ones(7, 26, 4))).shape
        torch.Size([7])
    """
    return OfStates(error)


@dataclass(frozen=True)
class OfStates:
    """Result of :func:`of_states`, which holds the error of states."""

    of_states: Callable[[Tensor], Tensor]

    def __call__(self, rollout: TensorDictBase) -> Tensor:
        """Errors (*batch) of rollouts (*batch, T).

        Raises:
            ValueError: as :func:`check_results`.
        """
        states = states_of(rollout)
        errors = self.of_states(states)
        check_results("error", errors, states.shape[:-2])
        return errors


def check_results(name: str, results: object, batch: Sequence[int], truth: bool = False) -> None:
    """Raise ValueError unless a function of motions (*batch) returned one value for each.

    Args:
        name: of the function, for the error.
        results: what it returned.
        batch: shape of the motions.
        truth: whether the values must be True or False; otherwise real numbers.

    Example:
        >>> check_results("success", torch.zeros(7), (7,), truth=True)
        Traceback (most recent call last):
        ValueError: success must return a bool tensor (7,), ..., got torch.float32 (7,)
    """
    if fault := fault_of_results(name, results, batch, truth):
        raise ValueError(fault)


def fault_of_results(name: str, results: object, batch: Sequence[int], truth: bool = False) -> str:
    """The line of :func:`check_results`; "" if nothing is wrong."""
    came = type(results).__name__
    if isinstance(results, Tensor):
        fits = (results.dtype == torch.bool) == truth and not results.is_complex()
        if fits and results.shape == tuple(batch):
            return ""
        came = f"{results.dtype} {tuple(results.shape)}"
    wanted = f"a {'bool' if truth else 'real'} tensor {tuple(batch)}"
    what = "whether each motion succeeds" if truth else "how far each motion is from success"
    return f"{name} must return {wanted}, {what}, got {came}"
