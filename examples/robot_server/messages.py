"""The messages between a robot and its client: fixed layouts of numbers, and nothing else.

A state is a status, the number of the rollout, a time stamp and D float64; a command is a letter,
the number of the rollout and, for an action, F float64; all little-endian. A message of another
size is refused.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

STATES, COMMANDS = "tcp://127.0.0.1:5555", "tcp://127.0.0.1:5556"  # nobody else's machine
ACTION, PUT_BACK, STOP = b"A", b"P", b"S"


class Status(IntEnum):
    """What the robot does."""

    HELD = 0  # at its start, until the first action
    MOVING = 1
    STOPPED = 2  # until it is put back at a start


@dataclass(frozen=True)
class State:
    """What a robot sends: the time stamp is in s, of its own clock."""

    status: Status
    rollout: int
    stamp: float
    entries: Sequence[float]


@dataclass(frozen=True)
class Command:
    """What a robot is commanded; the kind is ``ACTION``, ``PUT_BACK`` or ``STOP``."""

    kind: bytes
    rollout: int = 0
    action: Sequence[float] = ()


def pack_state(state: State) -> bytes:
    """A state as a message.

    Example:
        >>> unpack_state(pack_state(State(Status.HELD, 7, 1.5, (0.25, 0.5))), dim=2)
        State(status=<Status.HELD: 0>, rollout=7, stamp=1.5, entries=(0.25, 0.5))
    """
    layout = _state_layout(len(state.entries))
    return layout.pack(state.status, state.rollout, state.stamp, *state.entries)


def unpack_state(message: bytes, dim: int) -> State:
    """The state (dim,) that a message holds. Raises ValueError where it holds none."""
    status, rollout, stamp, *entries = _unpack(_state_layout(dim), message)
    return State(Status(status), rollout, stamp, tuple(entries))


def pack_command(command: Command) -> bytes:
    """A command as a message.

    Example:
        >>> unpack_command(pack_command(Command(ACTION, 7, (0.25,))), num_actions=1)
        Command(kind=b'A', rollout=7, action=(0.25,))
    """
    layout = _command_layout(len(command.action))
    return layout.pack(command.kind, command.rollout, *command.action)


def unpack_command(message: bytes, num_actions: int) -> Command:
    """The command that a message holds. Raises ValueError where it holds none."""
    layout = _command_layout(num_actions if message[:1] == ACTION else 0)
    kind, rollout, *action = _unpack(layout, message)
    if kind not in (ACTION, PUT_BACK, STOP):
        raise ValueError(f"a command must be one of A, P and S, got {kind!r}")
    if not all(map(math.isfinite, action)):
        raise ValueError(f"an action must be finite numbers, got {action}")
    return Command(kind, rollout, tuple(action))


def _state_layout(dim: int) -> struct.Struct:
    return struct.Struct(f"<BId{dim}d")


def _command_layout(num_actions: int) -> struct.Struct:
    return struct.Struct(f"<cI{num_actions}d")


def _unpack(layout: struct.Struct, message: bytes) -> tuple:
    if len(message) != layout.size:
        raise ValueError(f"a message must have {layout.size} bytes, got {len(message)}")
    return layout.unpack(message)
