"""LeRobot data sets: Parquet files with a row for each frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from torch_pmil.demonstrations.errors import (
    DemonstrationError,
    check_count,
    opened_set,
    optional,
    readable,
    within,
)
from torch_pmil.demonstrations.formats.entries import (
    choose,
    columns_of,
    names_of,
    natural_order,
    recordings_of,
)
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import read_json, short

INDEX = ("episode_index", "timestamp")  # columns that each file has
OBSERVED = "observation"  # prefix of the columns that may be read; no actions
# s, by which LeRobot's timestamps, in single precision, may differ from the stated rate
TOLERANCE = 1e-4


def read_lerobot(path: Path, keys: Sequence[str] = ()) -> Recordings:
    """The observations in the episodes of a LeRobot data set, version 2 or 3.

    Args:
        path: the folder with ``meta/info.json`` and ``data/chunk-*/*.parquet``, or a single Parquet
            file.
        keys: columns that begin with ``observation``, or single entries by the names in
            ``info.json``, or else as ``observation.state_0``. By default ``observation.state``.

    Raises:
        DemonstrationError: the data set is malformed, or does not have the keys.
        ImportError: pyarrow is missing.
    """
    info = _info(path) if path.is_dir() else {}
    files = [path]
    if path.is_dir():
        files = sorted(path.glob("data/*/*.parquet"), key=lambda file: natural_order(str(file)))
    if not files:
        raise DemonstrationError(
            "a LeRobot data set must hold files data/chunk-*/*.parquet, found none"
        )
    default = ["observation.state"]
    frames = _joined(_tables(files, path, keys or default))
    episodes, stamps = (frames.pop(name) for name in INDEX)
    if not len(episodes):
        raise DemonstrationError("there must be frames, found none")
    for row in np.flatnonzero(~np.isfinite(episodes))[:1]:
        raise DemonstrationError(f"row {row}, column episode_index must hold a number, got none")
    entries = choose(_groups(frames, info), keys, default)
    order = np.argsort(episodes, kind="stable")
    labels, starts = np.unique(episodes[order], return_index=True)
    check_count("demonstrations", len(labels))
    values = np.split(columns_of(frames, entries)[order], starts[1:])
    times = [_times(own, info.get("fps")) for own in np.split(stamps[order], starts[1:])]
    return recordings_of(
        (f"{label:.0f}" for label in labels), times, values, entries, format="LeRobot"
    )


def _info(folder: Path) -> dict[str, Any]:
    with readable("LeRobot data set"):
        info = read_json(folder / "meta" / "info.json")
    fps = info.get("fps") if isinstance(info, dict) else None
    rated = isinstance(fps, int | float) and fps > 0
    if not rated or not isinstance(info.get("features", {}), dict):
        raise DemonstrationError(
            f"meta/info.json must hold a positive fps and features, got fps {fps}"
        )
    return info


def _tables(files: Sequence[Path], root: Path, keys: Sequence[str]) -> list[dict[str, np.ndarray]]:
    """Readable columns of each file: (T,) or (T, width) each.

    Lists of several lengths are left out, unless ``keys`` name the column.
    """
    tables: list[dict[str, np.ndarray]] = []
    for file in files:
        with within(file.relative_to(root)) if file != root else nullcontext():
            table = _table(file)
            columns = {name: table[name] for name in table.column_names}
            tables.append(
                {
                    name: _array(name, column)
                    for name, column in columns.items()
                    if name in keys or not len(_uneven(column))
                }
            )
        check_count("numbers", sum(column.size for table in tables for column in table.values()))
    return tables


def _table(file: Path) -> Any:
    pyarrow, parquet = optional("pyarrow"), optional("pyarrow.parquet")
    with (
        opened_set(file, "a Parquet file", b"PAR1") as raw,
        readable("Parquet file", pyarrow.ArrowException),
        parquet.ParquetFile(raw) as content,
    ):
        schema = content.schema_arrow
        once = [name for name, times in Counter(schema.names).items() if times == 1]
        missing = set(INDEX) - set(once)
        if missing:
            raise DemonstrationError(
                f"column {min(missing)} is missing, found {', '.join(schema.names)}"
            )
        for name in INDEX:
            kind = schema.field(name).type
            if _is_list(kind) or not _is_numeric(kind):
                raise DemonstrationError(f"column {name} must hold numbers, got {kind}")
        observed = [
            name
            for name in once
            if name.startswith(OBSERVED) and _is_numeric(schema.field(name).type)
        ]
        if not observed:
            raise DemonstrationError(
                f"columns {OBSERVED}... of numbers are missing, found {', '.join(schema.names)}"
            )
        check_count("entries", len(observed))
        check_count("numbers", _size(content.metadata, (*INDEX, *observed)))
        return content.read(columns=[*INDEX, *observed])


def _size(metadata: Any, columns: Sequence[str]) -> int:
    """Stated count of numbers in some columns of a file."""
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    chunks = (group.column(index) for group in groups for index in range(group.num_columns))
    return sum(
        chunk.num_values for chunk in chunks if chunk.path_in_schema.split(".list.")[0] in columns
    )


def _is_list(kind: Any) -> bool:
    types = optional("pyarrow.types")
    return types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)


def _is_numeric(kind: Any) -> bool:
    types = optional("pyarrow.types")
    if _is_list(kind):
        kind = kind.value_type
    return types.is_floating(kind) or types.is_integer(kind)


def _array(name: str, column: Any) -> np.ndarray:
    if not (_is_list(column.type) and len(column)):
        return column.to_numpy().astype(np.float64)
    for odd in _uneven(column)[:1]:
        raise DemonstrationError(
            f"row {odd}, column {name} must hold numbers like row 0, got "
            f"{short(column[odd.item()].as_py())}"
        )
    numbers = optional("pyarrow.compute").list_flatten(column).to_numpy().astype(np.float64)
    return numbers.reshape(len(column), len(numbers) // len(column))


def _uneven(column: Any) -> np.ndarray:
    """Rows with a list of another length than the first, or without one."""
    if not (_is_list(column.type) and len(column)):
        return np.array([], int)
    widths = optional("pyarrow.compute").list_value_length(column).to_numpy()
    return np.flatnonzero(widths != widths[0])  # without a list it is NaN


def _joined(tables: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Columns that all files have in one shape, joined."""
    widths = [{name: column.shape[1:] for name, column in table.items()} for table in tables]
    shared = [
        name
        for name, width in widths[0].items()
        if all(other.get(name) == width for other in widths)
    ]
    return {name: np.concatenate([table[name] for table in tables]) for name in shared}


def _groups(frames: dict[str, np.ndarray], info: dict[str, Any]) -> dict[str, Sequence[str]]:
    """Names of each column's entries: those of the data set, if they are complete and unique."""
    groups: dict[str, Sequence[str]] = {}
    taken: set[str] = set()
    for key, array in frames.items():
        own, given = names_of(key, array.shape), _given_names(info.get("features", {}).get(key))
        groups[key] = given if len(set(given) - taken) == len(own) == len(given) else own
        taken.update(groups[key])
    return groups


def _given_names(feature: object) -> list[str]:
    """From a list, or from lists for the parts of a robot."""
    names = feature.get("names") if isinstance(feature, dict) else None
    parts = names.values() if isinstance(names, dict) else [names]
    return [str(name) for part in parts if isinstance(part, list) for name in part]


def _times(stamps: np.ndarray, fps: float | None) -> np.ndarray:
    """Times of an episode in double precision, evenly spaced if the stamps are, up to rounding."""
    steps = np.arange(len(stamps))
    step = 1 / fps if fps else (stamps[-1] - stamps[0]) / max(1, len(stamps) - 1)
    even = stamps[0] + step * steps
    return even if np.abs(even - stamps).max() <= TOLERANCE else stamps
