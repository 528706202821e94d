"""Angles that were recorded within one turn, and jump by it where the motion goes on."""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.dataset import Demonstrations
from torch_pmil.demonstrations.recordings import Recordings

TURNS = (2 * math.pi, 360.0)  # rad and degrees
MORE = 1.2  # turns, in which no wrapped angle with noise is
SMOOTH = 0.25  # of a turn, second difference of a motion without its jumps
JUMP = 0.7  # of a turn, second difference of a jump

Shown = TypeVar("Shown", bound=Recordings | Demonstrations)


def unwrapped(shown: Shown, turns: Mapping[str, float], near: Mapping[str, float]) -> Shown:
    """Recordings or demonstrations with unwrapped angles, which all begin within the same turn.

    Args:
        shown: what was recorded.
        turns: names of the entries that are angles, with the size of a turn.
        near: values near which these entries begin; by default, near those of the first recording.

    Example:
        >>> wrapped = torch.tensor([[3.0, -3.1, -2.9], [-3.2, -3.1, -2.9]])[..., None].double()
        >>> shown = Demonstrations(wrapped, 0.1, ("q",))
        >>> unwrapped(shown, {"q": 2 * math.pi}, {"q": 3.0}).positions[..., 0].round(decimals=2)
        tensor([[3.0000, 3.1800, 3.3800],
                [3.0800, 3.1800, 3.3800]], dtype=torch.float64)
    """
    values = [one.clone() for one in values_of(shown)]
    for name, turn in turns.items():
        if name not in shown.names:
            continue
        column = shown.names.index(name)
        start = near.get(name, values[0][0, column].item())
        for one in values:
            one[:, column] = _continued(one[:, column], start, turn)
    return with_values(shown, values)


def wrapping(shown: Recordings | Demonstrations) -> dict[str, tuple[float, int, int]]:
    """Entries that jump by a turn: its size, the first recording that does, and its sample.

    The entry must be smooth without the jumps and not smooth with them: a fast motion is no jump.
    """
    found = {}
    for column, name in enumerate(shown.names):
        if jump := first_jump(one[:, column] for one in values_of(shown)):
            found[name] = jump
    return found


def first_jump(motions: Iterable[Tensor]) -> tuple[float, int, int] | None:
    """Turn by which motions (T_n,) of one entry jump, the first that does, and its sample."""
    columns, found = [one.double().numpy() for one in motions], None
    for turn in TURNS:
        for number, one in enumerate(columns):
            if (sample := _jump(one, turn)) and not _rough(one, turn):
                found = turn, number, sample
                break
    return found


def wrapped_within(motions: Sequence[Tensor]) -> tuple[float, int, int] | None:
    """As :func:`first_jump`, of a sensor that never leaves the turn by which it jumps.

    Most motions that jump must be smooth without: one in many of a fast entry is so by chance.
    """
    jump, values = first_jump(motions), torch.cat(list(motions))
    if jump is None or values.amax() - values.amin() > MORE * jump[0]:
        return None
    columns, turn = [one.double().numpy() for one in motions], jump[0]
    rough = [_rough(one, turn) for one in columns if _jump(one, turn)]
    return None if 2 * sum(rough) > len(rough) else jump


def turns_of(shown: Recordings | Demonstrations, names: Sequence[str]) -> dict[str, float]:
    """Size of a turn of entries that are angles: 360 where they jump by it or exceed 4 pi.

    Warns of the first recording whose start is moved by turns of a size that no jump shows.
    """
    found = wrapping(shown)
    largest = [one.abs().amax(0) for one in values_of(shown)]
    turns = {}
    for name in names:
        column = shown.names.index(name)
        degrees = max(one[column].item() for one in largest) > 2 * TURNS[0]
        turns[name] = found[name][0] if name in found else TURNS[degrees]
        if name not in found:
            _doubt_starts(shown, name, turns[name])
    return turns


def jumps_by_turns(
    shown: Recordings | Demonstrations, declared: Collection[str] = ()
) -> Iterator[str]:
    """Entries that jump by a turn although nobody declared them angles, a line each."""
    for name, (turn, number, sample) in wrapping(shown).items():
        if name in declared:
            continue
        if isinstance(shown, Recordings):
            times = shown.times[number]
            at = (times[sample] - times[0]).item()
        else:
            at = shown.time_step * sample
        yield (
            f"{name} of demonstration {_label(shown, number)} jumps by a turn ({turn:.4g}) at "
            f"{at:.4g} s: if it is an angle, {declared_by(name, turn)} or "
            f"pmil align --angles {name}"
        )


def declared_by(name: str, turn: float) -> str:
    """How an angle of such a turn is declared; what a robot is given must be in rad.

    Example:
        >>> declared_by("q", 360.0)
        "convert it to rad and declare it, by angles=('q',)"
    """
    convert = "convert it to rad and " if turn == TURNS[1] else ""
    return f"{convert}declare it, by angles=({name!r},)"


def values_of(shown: Recordings | Demonstrations) -> list[Tensor]:
    """Observations of each recording or demonstration, (T_n, M)."""
    return [*(shown.positions if isinstance(shown, Demonstrations) else shown.values)]


def with_values(shown: Shown, values: Sequence[Tensor], **changes: Any) -> Shown:
    """The recordings or demonstrations with other observations (T_n, M), and other changes."""
    if isinstance(shown, Demonstrations):
        return replace(shown, positions=torch.stack(list(values)), **changes)
    return replace(shown, values=tuple(values), **changes)


def _label(shown: Recordings | Demonstrations, number: int) -> str:
    """The name of a demonstration, or else its number."""
    return shown.labels[number] if isinstance(shown, Recordings) else str(number)


def _doubt_starts(shown: Recordings | Demonstrations, name: str, turn: float) -> None:
    """Warn of the first recording that begins more than half a turn away from number 0."""
    starts = [one[0, shown.names.index(name)].item() for one in values_of(shown)]
    for number, start in enumerate(starts):
        if moved := -round((start - starts[0]) / turn) * turn:
            warnings.warn(
                f"{name} of demonstration {_label(shown, number)} begins at {start:.4g} and is "
                f"moved by {moved:+.4g}, near the {starts[0]:.4g} of demonstration "
                f"{_label(shown, 0)}: if a turn of {name} is not {turn:.4g}, convert it to rad, or "
                "do not declare it an angle",
                UserWarning,
                stacklevel=3,
            )
            return


def _continued(angles: Tensor, near: float, turn: float) -> Tensor:
    """Angles (T,) moved by whole turns, so that they go on, from the one nearest to ``near``."""
    steps = angles.diff(prepend=torch.tensor([near], dtype=angles.dtype))
    turns = (steps / turn).round()
    wraps = _jump(angles.numpy(), turn) and not _rough(angles.numpy(), turn)
    if angles.amax() - angles.amin() > MORE * turn and not wraps:
        turns[1:] = 0.0  # it goes on already, however fast
    return angles - turn * turns.cumsum(0)


def _jump(values: np.ndarray, turn: float) -> int:
    """The first sample after a jump by a turn, or 0."""
    steps = np.diff(values)
    jumps = np.flatnonzero(np.abs(steps) > turn / 2)
    bends = np.abs(np.diff(values, n=2))
    if not len(jumps) or not len(bends) or bends.max() < JUMP * turn:
        return 0
    return int(jumps[0]) + 1


def _rough(values: np.ndarray, turn: float) -> bool:
    bends = np.abs(np.diff(np.unwrap(values, period=turn), n=2))
    return bool(len(bends)) and bends.max() > SMOOTH * turn
