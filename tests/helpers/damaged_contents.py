"""Files of arrays with other contents, written by the library that writes such files."""

from __future__ import annotations

import importlib
import random
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat

DEEP: list = []
for _ in range(500):
    DEEP = [DEEP]
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 10**20, 10**400, 1e308, -1e-320, float("nan"), float("inf")),
    *("", "nan", "two\nlines", "'", "--config-dir=/", "x" * 100_000, [], {}, [[]], DEEP),
)
ARRAYS: tuple[np.ndarray, ...] = (
    *(np.zeros(0), np.zeros((3, 0)), np.zeros((2, 3, 4)), np.zeros(()), np.zeros((1, 20_000))),
    *(np.full(20, np.nan), np.full((20, 2), np.inf), np.full(20, 1e308), np.array(b"text")),
    *(np.zeros(20, bool), np.zeros(20, complex), np.arange(20)[::-1], np.arange(20, dtype="u1")),
)


def change_matlab(path: Path, kind: str, source: random.Random, trap: bytes) -> None:
    """Other fields of a stroke of a LASA file."""
    strokes = list(loadmat(path, simplify_cells=True)["demos"])
    _change(source.choice(strokes), kind, source, np.frombuffer(trap, np.uint8))
    demos = np.empty((1, len(strokes)), dtype=object)
    demos[0] = strokes
    savemat(path, {"demos": demos}, do_compression=source.random() < 0.5)


def change_hdf5(path: Path, kind: str, source: random.Random, trap: bytes) -> None:
    """Other members of a group."""
    h5py = importlib.import_module("h5py")
    with h5py.File(path, "a") as file:
        groups = [file]
        file.visititems(lambda _, node: groups.append(node) if hasattr(node, "keys") else None)
        _change(source.choice([one for one in groups if len(one)]), kind, source, np.void(trap))


def change_parquet(path: Path, kind: str, source: random.Random, trap: bytes) -> None:
    """Other columns."""
    pyarrow = importlib.import_module("pyarrow")
    parquet = importlib.import_module("pyarrow.parquet")
    table = parquet.read_table(path)
    columns = dict(zip(table.column_names, table.columns, strict=True))
    rows = len(table)
    name = source.choice(list(columns))
    if kind == "value":
        choices = ([None] * rows, ["x"] * rows, [[]] * rows, [np.nan] * rows, [1e308] * rows)
        ragged = [[0.0] * (row % 3) for row in range(rows)]
        columns[name] = pyarrow.array(source.choice((*choices, ragged, list(range(rows)))))
    else:
        _change(columns, kind, source, pyarrow.array([trap] * rows))
    parquet.write_table(pyarrow.table(columns), path)


def _change(
    members: MutableMapping[str, Any], kind: str, source: random.Random, trap: object
) -> None:
    """Swap two members, leave one out, or put another array or a trap in its place."""
    one, other = source.choice(sorted(members)), source.choice(sorted(members))
    held = members[one]
    if kind == "swap" and one != other:
        moved = members[other]
        del members[one], members[other]
        members[one], members[other] = moved, held
    elif kind == "lose":
        del members[one]
    elif kind in ("value", "trap value"):
        del members[one]
        members[one] = source.choice(ARRAYS) if kind == "value" else trap


CONTENTS = {".mat": change_matlab, ".hdf5": change_hdf5, ".parquet": change_parquet}
