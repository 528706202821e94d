"""CSV: one file with a row for each sample, or a folder with a file for each demonstration."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.errors import (
    TEXT_BYTES,
    DemonstrationError,
    check_count,
    check_names,
    readable,
    within,
)
from torch_pmil.demonstrations.formats.entries import Entry, choose, natural_order, recordings_of
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import read_bytes

TARGET_PREFIX = "target "  # of the columns that hold a target


class _Row(NamedTuple):
    place: str
    cells: list[str]


def read_csv(path: Path, keys: Sequence[str] = ()) -> Recordings:
    """The recordings of a CSV file, or of a folder of them.

    A file has a header ``demonstration,time,NAME,...`` and one row per sample: the number or name
    of the demonstration, the time in s, and the observed entries. In a folder each file is a
    demonstration, with the header ``time,NAME,...``. Columns ``target NAME`` hold the target, the
    same in all rows of a demonstration. ``keys`` name the columns to read, by default all.

    Raises DemonstrationError, with row and column, if a file is malformed.
    """
    leading = ("demonstration", "time")
    header, rows = _folder(path) if path.is_dir() else _file(path, leading)
    entries, targets = _columns(header, keys)
    read = [header.index(name) for name in ("time", *(entry.name for entry in entries), *targets)]
    parts: dict[str, list[_Row]] = {}
    for row in rows:
        parts.setdefault(row.cells[0].strip(), []).append(row)
    check_count("demonstrations", len(parts))
    if len(parts) < 2:
        raise DemonstrationError(f"at least two demonstrations are needed, got {len(parts)}")
    tables = [np.array([_numbers(row, header, read) for row in part]) for part in parts.values()]
    times, values, shown = zip(
        *(np.split(table, [1, 1 + len(entries)], axis=1) for table in tables), strict=True
    )
    return recordings_of(
        parts,
        (column[:, 0] for column in times),
        values,
        entries,
        targets=_targets(shown, list(parts.values()), targets) if targets else None,
        target_names=tuple(name.removeprefix(TARGET_PREFIX).strip() for name in targets),
        format="CSV",
        places=tuple(tuple(row.place for row in part) for part in parts.values()),
    )


def _file(path: Path, leading: tuple[str, ...], before: int = 0) -> tuple[list[str], list[_Row]]:
    """Header, which begins with ``leading``, and rows of a file, after cells of other files."""
    content = read_bytes(path, TEXT_BYTES)
    cells = content.count(b",") + max(content.count(end) for end in (b"\n", b"\r"))
    check_count("cells", before + cells)
    with readable("CSV file", csv.Error):
        text = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline="")
        lines = list(csv.reader(text, strict=True))
    header = [cell.strip() for cell in lines[0]] if lines else []
    check_count("entries", len(header))
    if tuple(header[: len(leading)]) != leading or all(
        name.startswith(TARGET_PREFIX) for name in header[len(leading) :]
    ):
        raise DemonstrationError(
            f"row 1 must be {','.join(leading)},NAME,..., got {','.join(header) or 'nothing'}"
        )
    rows = [_Row(f"row {number}", line) for number, line in enumerate(lines[1:], start=2) if line]
    for row in rows:
        if len(row.cells) != len(header):
            raise DemonstrationError(
                f"{row.place} must have {len(header)} columns, got {len(row.cells)}"
            )
    return header, rows


def _folder(path: Path) -> tuple[list[str], list[_Row]]:
    """The files of a folder as if they were one."""
    header: list[str] = []
    rows: list[_Row] = []
    for file in sorted(path.glob("*.csv"), key=lambda file: natural_order(file.name)):
        with within(file.name):
            own, lines = _file(file, ("time",), len(rows) * len(header))
            header = header or own
            if own != header:
                raise DemonstrationError(
                    f"row 1 must be {','.join(header)} as in the files before it, got "
                    f"{','.join(own)}"
                )
        rows += [_Row(f"{file.name}: {line.place}", [file.stem, *line.cells]) for line in lines]
    return ["demonstration", *header], rows


def _columns(header: list[str], keys: Sequence[str]) -> tuple[list[Entry], list[str]]:
    """The entries and the names of targets that are read."""
    targets = [name for name in header[2:] if name.startswith(TARGET_PREFIX)]
    names = [name for name in header[2:] if name not in targets]
    check_names(names, len(names))
    return choose({name: [name] for name in names}, keys, names), targets


def _targets(
    columns: Sequence[np.ndarray], parts: Sequence[Sequence[_Row]], names: Sequence[str]
) -> Tensor:
    """Targets (N, K) from columns (T_n, K), each of which must hold one number."""
    for rows, part in zip(columns, parts, strict=True):
        for sample, entry in np.argwhere(rows != rows[0])[:1]:
            raise DemonstrationError(
                f"{part[sample].place}, column {names[entry]} must be {rows[0, entry]:g} as in "
                f"{part[0].place} of the same demonstration, got {rows[sample, entry]:g}"
            )
    return torch.from_numpy(np.stack([rows[0] for rows in columns]))


def _numbers(row: _Row, header: Sequence[str], read: Sequence[int]) -> list[float]:
    numbers = []
    for column in read:
        try:
            numbers.append(float(row.cells[column]))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]):
            raise DemonstrationError(
                f"{row.place}, column {header[column]} must be a finite number, got "
                f"{row.cells[column]!r}"
            )
    return numbers
