"""Angles that a robot shows within one turn, continued beyond it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

TURN = 2 * math.pi
NOISE = 0.3  # rad, by which a reading may be beyond the turn


def within_half_a_turn(angle: Tensor) -> Tensor:
    """An angle (rad), moved by whole turns into [-pi, pi]."""
    return torch.atan2(angle.sin(), angle.cos())


@dataclass(frozen=True)
class Turning:
    """An angle (rad) among the observed entries.

    Args:
        entry: its index.
        rate: index of its velocity; None if that is not observed.
        near: value near which episodes start.
    """

    entry: int
    rate: int | None
    near: float


class Continued:
    """Observations (*batch, D) of an episode whose angles go on where they jump by a turn.

    A jump is a change by more than half a turn against the velocity, between two readings in
    [-pi, pi] or two in [0, 2 pi]. Other changes stay, however fast.

    Example:
        >>> shown = Continued([Turning(0, rate=None, near=3.0)])
        >>> [round(shown(torch.tensor([q])).item(), 2) for q in (3.0, -3.1, -2.9)]
        [3.0, 3.18, 3.38]
    """

    def __init__(self, angles: Sequence[Turning]) -> None:
        self.angles = tuple(angles)
        self._before: Tensor | None = None
        self._turns: list[Tensor] = []

    def __call__(self, shown: Tensor) -> Tensor:
        """The observation, continued from the one before."""
        if self._before is None:
            self._turns = [_first_turns(shown, angle) for angle in self.angles]
        else:
            steps = [_turns_of_step(self._before, shown, angle) for angle in self.angles]
            self._turns = [turns + step for turns, step in zip(self._turns, steps, strict=True)]
        self._before, state = shown.clone(), shown.clone()  # a robot may write into its reading
        for angle, turns in zip(self.angles, self._turns, strict=True):
            state[..., angle.entry] += TURN * turns
        return state


def _first_turns(shown: Tensor, angle: Turning) -> Tensor:
    first = shown[..., angle.entry]
    return ((angle.near - first) / TURN).round()


def _turns_of_step(before: Tensor, now: Tensor, angle: Turning) -> Tensor:
    pair = torch.stack([before[..., angle.entry], now[..., angle.entry]])
    change, low, high = pair[1] - pair[0], pair.amin(0), pair.amax(0)
    around_zero = (low >= -math.pi - NOISE) & (high <= math.pi + NOISE)
    from_zero = (low >= -NOISE) & (high <= TURN + NOISE)
    jumps = (change.abs() > math.pi) & (around_zero | from_zero)
    if angle.rate is not None:
        jumps &= change * (before[..., angle.rate] + now[..., angle.rate]) < 0
    return -change.sign() * jumps
