"""Declared angles of a robot and its recordings, on the same turn."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import Demonstrations, Recordings
from torch_pmil.demonstrations.turns import jumps_by_turns, unwrapped
from torch_pmil.envs.turning import TURN, Turning


def turning(observed: Sequence[str], space: StateSpace, near: Tensor) -> tuple[Turning, ...]:
    """The angles that an observation shows as they are; episodes start near a state (D,)."""
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

    Warns of holes, and of entries that jump by a turn although they were not declared.
    """
    match, turns = space.match_space, {}
    for name, weights in zip(match.names, match.weights, strict=True):
        used = weights.nonzero().flatten().tolist()
        sizes = weights[used].abs()
        if used and set(used) <= set(space.angles) and torch.all(sizes == sizes[0]):
            turns[name] = TURN * sizes[0].item()
    shown = None if near is None else dict(zip(match.names, match(near).tolist(), strict=True))
    recorded = unwrapped(recorded, turns, shown or {})
    holes = recorded.holes() if isinstance(recorded, Recordings) else []
    for doubt in [*holes, *jumps_by_turns(recorded)]:
        warnings.warn(doubt, UserWarning, stacklevel=5)
    return recorded
