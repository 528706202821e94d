"""CSV: one file with a row for each sample, or a folder with a file for each demonstration."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from contextlib import nullcontext
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.errors import (
    HEAD,
    TEXT_BYTES,
    DemonstrationError,
    check_count,
    check_kind,
    readable,
    within,
)
from torch_pmil.demonstrations.formats.entries import Entry, choose, natural_order, recordings_of
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import read_bytes

TARGET_PREFIX = "target "  # of the columns that hold a target
LABEL, TIME = "demonstration", "time"
TIME_NAME = re.compile(
    r"(?:time|timestamp|t)(?:[ _]*[ _(\[](?P<unit>s|sec|seconds|ms|[uµμ]s|ns)[)\]]?)?",
    re.IGNORECASE,
)
NUMBER = re.compile(r"[-+]?\d+(\.\d*)?")  # as a label
COMMA = re.compile(r"\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*", re.IGNORECASE)  # in place of a point
PER_SECOND = {"m": 1e3, "u": 1e6, "µ": 1e6, "μ": 1e6, "n": 1e9}  # by the first letter of the unit


class _Row(NamedTuple):
    place: str
    cells: list[str]


class _Table(NamedTuple):
    """A file: its label if it is one demonstration, its columns, its times' unit, its rows."""

    name: str
    label: str
    header: list[str]  # in which the column of the time is called TIME
    unit: str  # of the time; empty if the header does not state it
    rows: list[_Row]


def read_csv(path: Path, keys: Sequence[str] = ()) -> Recordings:
    """The recordings of a CSV file, or of a folder of them.

    A file has a header ``demonstration,time,NAME,...`` and one row per sample: the number or name
    of the demonstration, the time in s, and the observed entries. In a folder each file is a
    demonstration, with the header ``time,NAME,...``. Columns may be in any order, separated by
    commas, semicolons or tabs. A name such as ``time_ms`` or ``timestamp [ns]`` states another unit
    of the time. Columns ``target NAME`` hold the target, the same in all rows of a demonstration.
    ``keys`` name the columns to read, by default all; others may hold anything.

    Raises DemonstrationError, with row and column, if a file is malformed.
    """
    tables = _tables(path)
    entries, targets = _columns(tables[0].header, keys)
    read = [TIME, *(entry.name for entry in entries), *targets]
    parts: dict[str, list[_Row]] = {}
    numbers: dict[str, list[list[float]]] = {}
    spelled: dict[str | Decimal, str] = {}  # labels as they came first
    for table in tables:
        with within(table.name) if table.label else nullcontext():
            columns = _places(table.header, read, () if keys else tables[0].header)
        for row in table.rows:
            label = table.label or _label(row, table.header.index(LABEL), spelled)
            parts.setdefault(label, []).append(row)
            numbers.setdefault(label, []).append(_numbers(row, read, columns, table.unit))
    check_count("demonstrations", len(parts))
    if len(parts) < 2:
        raise DemonstrationError(f"at least two demonstrations are needed, got {len(parts)}")
    times, values, shown = zip(
        *(np.split(np.array(one), [1, 1 + len(entries)], axis=1) for one in numbers.values()),
        strict=True,
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
        in_seconds=all(table.unit for table in tables),
    )


def _tables(path: Path) -> list[_Table]:
    """The file, or those of a folder in the order of the numbers in their names."""
    if not path.is_dir():
        return [_table(path, "", 0)]
    tables: dict[str, _Table] = {}
    cells = 0
    files = [file for file in path.iterdir() if file.suffix.lower() == ".csv"]
    for file in sorted(files, key=lambda file: natural_order(file.name)):
        with within(file.name):
            if file.stem in tables:
                raise DemonstrationError(
                    f"its name must differ from those of the files before it, got {file.stem} again"
                )
            table = tables[file.stem] = _table(file, file.stem, cells)
        cells += len(table.rows) * len(table.header)
    return [*tables.values()]


def _table(path: Path, label: str, before: int) -> _Table:
    """A file, after cells of other files; with a label it is one demonstration."""
    content = read_bytes(path, TEXT_BYTES)
    check_kind("a CSV file", content[:HEAD])
    first = content.partition(b"\n")[0]
    delimiter = max(b",", b";", b"\t", key=first.count)
    cells = content.count(delimiter) + max(content.count(end) for end in (b"\n", b"\r"))
    check_count("cells", before + cells)
    with readable("CSV file", csv.Error):
        text = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline="")
        cut = delimiter.decode()
        lines = list(csv.reader(text, strict=True, delimiter=cut, skipinitialspace=True))
    held = [(number, line) for number, line in enumerate(lines, 1) if any(map(str.strip, line))]
    named = len(_trimmed(lines[0])) if lines else 0
    if any(len(_trimmed(line)) > named for _, line in held):  # numbers in a column without a name
        named = len(lines[0])
    header, unit = _header(lines[0][:named] if lines else [], () if label else (LABEL,))
    of_file = f"{path.name}: " if label else ""
    rows = [
        _Row(f"{of_file}row {number}", _trimmed(line, named)) for number, line in held if number > 1
    ]
    for row in rows:
        if len(row.cells) != len(header):
            raise DemonstrationError(
                f"{row.place} must have {len(header)} columns, got {len(row.cells)}"
            )
    if label and not rows:
        raise DemonstrationError("must hold samples, got a header alone")
    return _Table(path.name, label, header, unit, rows)


def _trimmed(line: list[str], least: int = 0) -> list[str]:
    """A line without the empty cells at its end, beyond the ``least`` first."""
    count = len(line)
    while count > least and not line[count - 1].strip():
        count -= 1
    return line[:count]


def _header(cells: list[str], leading: tuple[str, ...]) -> tuple[list[str], str]:
    """The names of the columns, with TIME for the column of the time, and the unit of the time."""
    header = [cell.strip() for cell in cells]
    check_count("entries", len(header))
    matches = {name: match for name in header if (match := TIME_NAME.fullmatch(name))}
    times = [TIME] if TIME in matches else list(matches)
    others = set(header) - {*leading, *times}
    right = len(times) == 1 and header.count(times[0]) == 1
    right &= all(header.count(name) == 1 for name in leading)
    if not right or all(name.startswith(TARGET_PREFIX) for name in others):
        raise DemonstrationError(
            f"row 1 must be {','.join((*leading, TIME))},NAME,..., got "
            f"{','.join(header) or 'nothing'}"
        )
    unit = (matches[times[0]]["unit"] or "").lower()
    return [TIME if name == times[0] else name for name in header], unit


def _columns(header: list[str], keys: Sequence[str]) -> tuple[list[Entry], list[str]]:
    """The entries and the names of targets that are read."""
    targets = [name for name in header if name.startswith(TARGET_PREFIX)]
    names = [name for name in header if name not in (LABEL, TIME, *targets)]
    return choose({name: [name] for name in names}, keys, names), targets


def _places(header: Sequence[str], read: Sequence[str], same: Sequence[str]) -> list[int]:
    """The columns of a header that are read, and each of which must be there once."""
    for name in sorted(set(header) ^ set(same)) if same else ():
        raise DemonstrationError(
            "row 1 must have the columns of the files before it, unless keys choose some, but "
            f"{name} is only in {'this one' if name in header else 'those'}"
        )
    for name in read:
        if (times := header.count(name)) != 1:
            raise DemonstrationError(f"row 1 must hold a column {name} once, got {times} of them")
    return [header.index(name) for name in read]


def _label(row: _Row, column: int, spelled: dict[str | Decimal, str]) -> str:
    """The label of a row, as it came first: 0 and 0.0 are the same."""
    label = row.cells[column].strip()
    if not label:
        raise DemonstrationError(f"{row.place}, column {LABEL} must hold a name, got none")
    return spelled.setdefault(Decimal(label) if NUMBER.fullmatch(label) else label, label)


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


def _numbers(row: _Row, names: Sequence[str], columns: Sequence[int], unit: str) -> list[float]:
    """The numbers in some columns, of which the first is the time, in s."""
    numbers = []
    for name, column in zip(names, columns, strict=True):
        cell = row.cells[column]
        try:
            numbers.append(math.nan if "_" in cell else float(cell))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]):
            needed = name == TIME or name.startswith(TARGET_PREFIX)
            wanted = "a finite number" + ("" if needed else ", or left out by keys")
            comma = "; write a decimal point" if COMMA.fullmatch(cell) else ""
            raise DemonstrationError(
                f"{row.place}, column {name} must be {wanted}, got {cell!r}{comma}"
            )
    return [numbers[0] / PER_SECOND.get(unit[:1], 1.0), *numbers[1:]]
