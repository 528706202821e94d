"""Declared angles of a robot and its recordings, on the same turn."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import DemonstrationError, Demonstrations, Recordings
from torch_pmil.demonstrations.turns import jumps_by_turns, unwrapped, values_of, wrapping
from torch_pmil.envs.turning import TURN, Turning

FAR = 2  # turns, over which few robots turn, and most angles in degrees do


def turning(observed: Sequence[str], space: StateSpace, near: Tensor) -> tuple[Turning, ...]:
    """The angles that an observation shows as they are; episodes start near a state (D,).

    Warns of starts that look like degrees.
    """
    for index in space.angles:
        name, start = space.names[index], near[index].item()
        if not space.units[index] and abs(start) > FAR * TURN:
            _warn(_in_degrees(name, f"the robot starts at {start:.4g}", TURN))
    entries = list(observed)
    return tuple(
        Turning(
            entries.index(name),
            entries.index(f"d{name}") if f"d{name}" in entries else None,
            near[index].item(),
        )
        for index, name in enumerate(space.names)
        if index in space.angles and name in entries
    )


def on_one_turn(
    recorded: Demonstrations | Recordings, space: StateSpace, near: Tensor | None
) -> Demonstrations | Recordings:
    """What was recorded, its declared angles continued, and beginning near a state (D,).

    Warns of holes, of declared angles that look like degrees, and of entries that jump by a turn
    although they were not declared.

    Raises:
        DemonstrationError: a declared angle jumps by a turn in degrees, and should not.
    """
    match, turns = space.match_space, {}
    for name, weights in zip(match.names, match.weights, strict=True):
        used = weights.nonzero().flatten().tolist()
        sizes = weights[used].abs()
        if used and set(used) <= set(space.angles) and torch.all(sizes == sizes[0]):
            turns[name] = TURN * sizes[0].item()
    _check_jumps(recorded, turns)
    far = [*_far_turned(recorded, space, turns)]
    shown = None if near is None else dict(zip(match.names, match(near).tolist(), strict=True))
    recorded = unwrapped(recorded, turns, shown or {})
    holes = recorded.holes() if isinstance(recorded, Recordings) else []
    for doubt in [*holes, *far, *jumps_by_turns(recorded, turns)]:
        _warn(doubt)
    return recorded


def _check_jumps(recorded: Demonstrations | Recordings, turns: Mapping[str, float]) -> None:
    """Raise DemonstrationError if a declared angle jumps by a turn in degrees, and has another."""
    for name, (jump, _, _) in wrapping(recorded).items():
        if name in turns and jump > max(TURN, FAR * turns[name]):
            raise DemonstrationError(
                f"{name} looks like degrees: its recordings jump by {jump:.4g}, where a turn is "
                f"{turns[name]:.4g}; convert it to rad"
            )


def _far_turned(
    recorded: Demonstrations | Recordings, space: StateSpace, turns: Mapping[str, float]
) -> Iterator[str]:
    """A line for each declared angle of unknown unit that turns as far as one in degrees."""
    units = dict(zip(space.match_space.names, space.match_space.units, strict=True))
    for column, name in enumerate(recorded.names):
        if name not in turns or units[name]:
            continue
        width = max((one.amax(0) - one.amin(0))[column].item() for one in values_of(recorded))
        if width > FAR * turns[name]:
            yield _in_degrees(name, f"it is recorded over {width:.4g}", turns[name])


def _in_degrees(name: str, what: str, turn: float) -> str:
    return (
        f"{name} looks like degrees: {what}, where a turn is {turn:.4g}; angles must be in rad, so "
        "convert it, or give its unit, rad, by units= if it turns so far"
    )


def _warn(doubt: str) -> None:
    warnings.warn(doubt, UserWarning, stacklevel=6)
