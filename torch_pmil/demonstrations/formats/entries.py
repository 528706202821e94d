"""Names of a file's entries, and the choice of those that are read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_pmil.demonstrations.errors import (
    DemonstrationError,
    UnknownEntryError,
    check_count,
)
from torch_pmil.demonstrations.recordings import Recordings

Groups = Mapping[str, Sequence[str]]  # names of the entries that a key of a file holds


class Entry(NamedTuple):
    """One number of each sample: its key in the file, its column under that key, and its name."""

    key: str
    column: int
    name: str


def names_of(key: str, shape: Sequence[int]) -> tuple[str, ...]:
    """Default names of a key's entries: the key, or the key and a number.

    Raises DemonstrationError if there are too many.

    Example:
        >>> names_of("gap", (100,)), names_of("hand", (100, 2))
        (('gap',), ('hand_0', 'hand_1'))
    """
    if len(shape) == 1:
        return (key,)
    check_count("entries", shape[1])
    return tuple(f"{key}_{column}" for column in range(shape[1]))


def choose(groups: Groups, keys: Sequence[str], default: Sequence[str]) -> list[Entry]:
    """The entries that ``keys`` name, in that order, or else those of ``default``.

    A key is one of ``groups``, for all its entries, or the name of one entry. Raises
    UnknownEntryError if a key is missing, DemonstrationError if there are neither keys nor a
    default.

    Example:
        >>> groups = {"pos": ("x", "y"), "vel": ("dx", "dy")}
        >>> [entry.name for entry in choose(groups, ["vel", "x"], ())]
        ['dx', 'dy', 'x']
    """
    check_count("entries", sum(map(len, groups.values())))
    entries = {
        key: [Entry(key, column, name) for column, name in enumerate(names)]
        for key, names in groups.items()
    }
    single = {entry.name: [entry] for held in entries.values() for entry in held}
    wanted = keys or default
    if not wanted:
        raise DemonstrationError(f"keys must say what to read: some of {_listed(groups)}")
    unknown = [key for key in wanted if key not in entries and key not in single]
    if unknown:
        raise UnknownEntryError(f"keys must be some of {_listed(groups)}, got {unknown[0]}")
    chosen = [entry for key in wanted for entry in entries.get(key, single.get(key, []))]
    if not chosen:
        raise DemonstrationError(f"{', '.join(wanted)} must hold entries, got none")
    return chosen


def columns_of(arrays: Mapping[str, np.ndarray], entries: Sequence[Entry]) -> np.ndarray:
    """The chosen entries side by side, (T, M), float64, of arrays (T,) or (T, width)."""
    tables = {key: array if array.ndim == 2 else array[:, None] for key, array in arrays.items()}
    return np.stack([tables[entry.key][:, entry.column] for entry in entries], 1).astype(np.float64)


def natural_order(name: str) -> list[tuple[int, str]]:
    """Sort key for names with numbers.

    Example:
        >>> sorted(["demo_10", "demo_9"], key=natural_order)
        ['demo_9', 'demo_10']
    """
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", name)]


def recordings_of(
    labels: Iterable[object],
    times: Iterable[np.ndarray],
    values: Iterable[np.ndarray],
    entries: Sequence[Entry],
    **others: Any,
) -> Recordings:
    """Recordings of the chosen entries from arrays; ``others`` are further fields."""
    return Recordings(
        tuple(map(str, labels)),
        tuple(map(torch.from_numpy, times)),
        tuple(map(torch.from_numpy, values)),
        tuple(entry.name for entry in entries),
        **others,
    )


def _listed(groups: Groups) -> str:
    listed = [
        key if tuple(names) == (key,) else f"{key} ({', '.join(names)})"
        for key, names in groups.items()
    ]
    return ", ".join(listed) or "nothing"
