"""Demonstrations: observed trajectories of equal length, without actions. Load, check, save."""

from __future__ import annotations

import csv
import math
import os
import zipfile
import zlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_pmil.files import replacing

TIME_STEP_TOLERANCE = 1e-6  # relative difference between two time steps that count as equal
TARGET_PREFIX = "target "  # of a CSV file's columns that hold a target


class DemonstrationError(ValueError):
    """Demonstrations are malformed; the message says where, what was expected and what came, in one line."""


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Observed trajectories of N demonstrations of one task, sampled at the same times, time 0 included.

    Attributes:
        positions: what was observed, (N, T+1, M), float64; for the double pendulum [x1, y1, x2, y2] in m.
        time_step: seconds between two samples.
        names: names of the M observed coordinates.
        targets: what each demonstration was for, (N, K), float64, as where the ball hung. None where all are for one thing.
        target_names: names of the K entries of a target.

    Raises:
        DemonstrationError: a shape is wrong, there are fewer than two demonstrations (of each target) or samples, a number is not
            finite, or the time step is not positive.

    Example:
        >>> Demonstrations(torch.zeros(2, 26, 1), time_step=0.1, names=("x",)).duration
        2.5
    """

    positions: Tensor  # (N, T+1, M)
    time_step: float
    names: tuple[str, ...]
    targets: Tensor | None = None  # (N, K)
    target_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", torch.as_tensor(self.positions).to(torch.float64))
        object.__setattr__(self, "time_step", float(self.time_step))
        object.__setattr__(self, "names", tuple(str(name) for name in self.names))
        object.__setattr__(self, "target_names", tuple(str(name) for name in self.target_names))
        self._check_shapes()
        if not (math.isfinite(self.time_step) and self.time_step > 0):
            raise DemonstrationError(f"time_step must be positive and finite, in seconds, got {self.time_step}")
        bad = (~self.positions.isfinite()).nonzero()
        if len(bad):
            demonstration, step, column = bad[0].tolist()
            raise DemonstrationError(
                f"positions must be finite, got {self.positions[demonstration, step, column].item()} in "
                f"demonstration {demonstration}, step {step}, column {self.names[column]}"
            )
        if self.targets is not None:
            object.__setattr__(self, "targets", torch.as_tensor(self.targets).to(torch.float64))
            self._check_targets()
        elif self.target_names:
            raise DemonstrationError(f"target_names must come with targets, got {self.target_names} alone")

    def _check_targets(self) -> None:
        N, shape, names = len(self.positions), tuple(self.targets.shape), self.target_names
        if len(shape) != 2 or shape[0] != N or shape[1] < 1:
            raise DemonstrationError(f"targets must have shape ({N}, entries), one for each demonstration, got {shape}")
        if len(names) != shape[1] or len(set(names)) != shape[1]:
            raise DemonstrationError(f"target_names must be {shape[1]} different names, one per entry, got {names}")
        bad = (~self.targets.isfinite()).nonzero()
        if len(bad):
            demonstration, entry = bad[0].tolist()
            raise DemonstrationError(
                f"targets must be finite, got {self.targets[demonstration, entry].item()} of demonstration {demonstration}"
            )
        distinct, counts = self.targets.unique(dim=0, return_counts=True)
        if (counts < 2).any():
            lonely = distinct[counts.argmin()].tolist()
            raise DemonstrationError(f"each target must have at least two demonstrations, got one of {lonely}")

    def by_target(self) -> tuple[Tensor, tuple[Demonstrations, ...]]:
        """The S different targets (S, K), in the order in which they came, and the demonstrations of each.

        Raises:
            DemonstrationError: they have no targets.

        Example:
            >>> two = torch.tensor([[0.0], [0.0], [1.0], [1.0]])
            >>> targets, sets = Demonstrations(torch.zeros(4, 26, 1), 0.1, ("x",), two, ("place",)).by_target()
            >>> targets.tolist(), sets[1].positions.shape
            ([[0.0], [1.0]], torch.Size([2, 26, 1]))
        """
        if self.targets is None:
            raise DemonstrationError("demonstrations must have targets, got none")
        distinct = torch.tensor(list(dict.fromkeys(map(tuple, self.targets.tolist()))), dtype=torch.float64)
        of_target = [self.positions[(self.targets == target).all(-1)] for target in distinct]
        return distinct, tuple(Demonstrations(positions, self.time_step, self.names) for positions in of_target)

    def _check_shapes(self) -> None:
        shape = tuple(self.positions.shape)
        if len(shape) != 3:
            raise DemonstrationError(f"positions must have shape (demonstrations, steps, columns), got {shape}")
        if shape[0] < 2:
            raise DemonstrationError(f"positions must hold at least two demonstrations, got {shape[0]}")
        if shape[1] < 2:
            raise DemonstrationError(f"positions must hold at least two steps, got {shape[1]}")
        if shape[2] < 1 or len(self.names) != shape[2] or len(set(self.names)) != shape[2]:
            raise DemonstrationError(f"names must be {shape[2]} different names, one per column, got {self.names}")

    @property
    def duration(self) -> float:
        """Time of the last sample in seconds; the first is at 0."""
        return self.time_step * (self.positions.shape[1] - 1)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an NPZ file with positions, time_step, names, and targets and target_names if there are any: wholly or not at all.

        Args:
            path: of the file; one that is there is replaced.

        Raises:
            OSError: the folder is missing or not writable.
        """
        with replacing(Path(path)) as temporary, temporary.open("wb") as file:
            np.savez(file, positions=self.positions.numpy(), time_step=self.time_step, names=np.array(self.names), **self._target_arrays())

    def _target_arrays(self) -> dict[str, np.ndarray]:
        return {} if self.targets is None else {"targets": self.targets.numpy(), "target_names": np.array(self.target_names)}


def load_demonstrations(path: str | os.PathLike[str], time_step: float | None = None) -> Demonstrations:
    """Load demonstrations from an NPZ file written by ``Demonstrations.save``, or from a CSV file.

    A CSV file starts with a header ``demonstration,time,NAME,...`` and has one row per sample: the number or name
    of the demonstration, the time in s, and the observed coordinates. Columns ``target NAME`` hold its target, the same in all of its
    rows. The samples of one demonstration follow each other in time; all demonstrations have equally many of them, at one time step.

    Args:
        path: of the file, ending in .npz or .csv.
        time_step: seconds between samples that the file must have; None takes what the file has.

    Returns:
        The demonstrations of the file.

    Raises:
        DemonstrationError: the file is malformed; the message names it, and the row and column of a CSV.
        OSError: the file cannot be read.
    """
    path = Path(path)
    loaders = {".npz": _load_npz, ".csv": _load_csv}
    if path.suffix not in loaders:
        raise DemonstrationError(f"{path}: demonstrations must be a .npz or .csv file")
    try:
        demonstrations = loaders[path.suffix](path)
    except DemonstrationError as error:
        raise DemonstrationError(f"{path}: {error}") from error.__cause__
    if time_step is not None and not math.isclose(demonstrations.time_step, time_step, rel_tol=TIME_STEP_TOLERANCE):
        raise DemonstrationError(f"{path}: time_step must be {time_step} s, got {demonstrations.time_step} s")
    return demonstrations


@dataclass(frozen=True, eq=False)
class Recordings:
    """Demonstrations as they were recorded: of lengths and at times of their own.

    Attributes:
        labels: number or name of each of the N demonstrations.
        times: of the samples of each, increasing, in s, (T_n,), float64.
        values: what was observed, (T_n, M), float64.
        names: of the M observed coordinates.
        targets: what each was for, (N, K), float64; None where the file has none.
        target_names: of the K entries of a target.
    """

    labels: tuple[str, ...]
    times: tuple[Tensor, ...]
    values: tuple[Tensor, ...]
    names: tuple[str, ...]
    targets: Tensor | None = None
    target_names: tuple[str, ...] = ()


def load_recordings(path: str | os.PathLike[str]) -> Recordings:
    """Load what was recorded from a CSV file as ``load_demonstrations`` takes, but with any number of samples at any times.

    Args:
        path: of the file.

    Returns:
        The recordings, in the order of the file.

    Raises:
        DemonstrationError: the file is malformed; the message names it, and the row and column.
        OSError: the file cannot be read.
    """
    try:
        table = _csv_table(Path(path))
        for label, rows in table.rows.items():
            late = np.flatnonzero(np.diff(rows[:, 0]) <= 0)
            if len(late):
                before, after = rows[late[0], 0], rows[late[0] + 1, 0]
                raise DemonstrationError(
                    f"row {table.numbers[label][late[0] + 1]}, column time must increase, got {after:g} s after {before:g} s"
                )
    except DemonstrationError as error:
        raise DemonstrationError(f"{path}: {error}") from error.__cause__
    samples = [torch.from_numpy(rows) for rows in table.rows.values()]  # (T_n, 1 + M)
    times, values = (tuple(part) for part in zip(*((each[:, 0], each[:, 1:]) for each in samples), strict=True))
    return Recordings(tuple(table.rows), times, values, table.names, table.targets, table.target_names)


def shipped_demonstrations(name: str = "double_pendulum") -> Demonstrations:
    """The demonstrations that come with the package.

    Args:
        name: of what was demonstrated:
            ``"double_pendulum"``: five swing-ups, positions [x1, y1, x2, y2] in m, at 10 Hz from 0 to 2.5 s;
            ``"double_pendulum_targets"``: three motions to each of three places of the tip, their targets [x, y] in m,
            positions and times as those of the swing-ups;
            ``"gym_pendulum"``: five swing-ups of gymnasium's Pendulum-v1, its tip [x, y] in m, at 10 Hz from 0 to 4 s;
            ``"inverted_pendulum"``: ten recoveries of gymnasium's InvertedPendulum-v5, [x_cart, x_tip, z_tip] in m, at 25 Hz from 0 to 2 s;
            ``"biorob"``: three strikes of the BioRob, led by hand and aligned in time, [q, dq] of yaw, shoulder and elbow in rad and rad/s,
            at 10 Hz from 0 to 1.8 s;
            ``"biorob_targets"``: six strikes of the BioRob, two at each of three balls, all led by hand and aligned in time, as those;
            targets are the balls' places [y, z] in the hitting plane, m.

    Returns:
        The demonstrations.

    Raises:
        DemonstrationError: there are none of that name.

    Example:
        >>> shipped_demonstrations().positions.shape
        torch.Size([5, 26, 4])
    """
    shipped = {file.name.removesuffix(".npz"): file for file in resources.files("torch_pmil").joinpath("data").iterdir()}
    shipped = {stem: file for stem, file in shipped.items() if file.name == f"{stem}.npz"}
    if name not in shipped:
        raise DemonstrationError(f"shipped demonstrations must be one of {sorted(shipped)}, got {name}")
    with resources.as_file(shipped[name]) as path:
        return load_demonstrations(path)


def _load_npz(path: Path) -> Demonstrations:
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error, AttributeError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise DemonstrationError(f"not a readable NPZ file without object arrays ({reason})") from error
    for name in ("positions", "time_step", "names"):
        if name not in arrays:
            raise DemonstrationError(f"array {name} is missing, found {sorted(arrays)}")
    if arrays["positions"].dtype.kind not in "fiu" or arrays["time_step"].dtype.kind not in "fiu":
        raise DemonstrationError("arrays positions and time_step must hold real numbers")
    if arrays["time_step"].shape != () or arrays["names"].ndim != 1:
        raise DemonstrationError("array time_step must be one number and names a list")
    targets, target_names = arrays.get("targets"), arrays.get("target_names", np.array([]))
    if (targets is not None and targets.dtype.kind not in "fiu") or target_names.ndim != 1:
        raise DemonstrationError("array targets must hold real numbers and target_names be a list")
    return Demonstrations(
        torch.from_numpy(arrays["positions"]),
        arrays["time_step"].item(),
        tuple(arrays["names"]),
        None if targets is None else torch.from_numpy(targets),
        tuple(target_names),
    )


def _load_csv(path: Path) -> Demonstrations:
    table = _csv_table(path)
    _check_csv_lengths(table.rows)
    samples = np.stack(list(table.rows.values()))  # (N, T+1, 1+M)
    time_step = _csv_time_step(samples[:, :, 0], list(table.numbers.values()))
    return Demonstrations(torch.from_numpy(samples[:, :, 1:]), time_step, table.names, table.targets, table.target_names)


@dataclass(frozen=True, eq=False)
class _CsvTable:
    rows: dict[str, np.ndarray]  # [time, values] of each demonstration, (T_n, 1+M)
    numbers: dict[str, list[int]]  # of those rows in the file
    names: tuple[str, ...]
    targets: Tensor | None  # (N, K)
    target_names: tuple[str, ...]


def _csv_lines(path: Path) -> list[list[str]]:
    with open(path, newline="", encoding="utf-8-sig") as file:
        try:
            return list(csv.reader(file, strict=True))
        except (csv.Error, UnicodeDecodeError) as error:
            raise DemonstrationError(f"not a readable CSV file ({error})") from error


def _csv_table(path: Path) -> _CsvTable:
    lines = _csv_lines(path)
    header = [cell.strip() for cell in lines[0]] if lines else []
    of_target = np.array([name.startswith(TARGET_PREFIX) for name in header[1:]], dtype=bool)
    if header[:2] != ["demonstration", "time"] or of_target[1:].all():
        raise DemonstrationError(f"row 1 must be demonstration,time,NAME,..., got {','.join(header)}")
    samples: dict[str, list[list[float]]] = {}
    numbers: dict[str, list[int]] = {}
    for number, line in enumerate(lines[1:], start=2):
        if line:
            samples.setdefault(line[0].strip(), []).append(_csv_numbers(line, header, number))
            numbers.setdefault(line[0].strip(), []).append(number)
    if len(samples) < 2:
        raise DemonstrationError(f"at least two demonstrations are needed, got {len(samples)}")
    rows, names = {label: np.array(cells) for label, cells in samples.items()}, np.array(header[1:])
    observed, shown = ({label: table[:, columns] for label, table in rows.items()} for columns in (~of_target, of_target))
    targets = _csv_targets(shown, numbers, names[of_target]) if of_target.any() else None
    target_names = tuple(name.removeprefix(TARGET_PREFIX).strip() for name in names[of_target].tolist())
    return _CsvTable(observed, numbers, tuple(names[~of_target][1:].tolist()), targets, target_names)


def _csv_targets(columns: dict[str, np.ndarray], numbers: dict[str, list[int]], names: np.ndarray) -> Tensor:
    """The target of each demonstration (N, K), of columns (T_n, K) that must each hold one number."""
    for label, rows in columns.items():
        other = np.argwhere(rows != rows[0])
        if len(other):
            step, entry = other[0]
            raise DemonstrationError(
                f"row {numbers[label][step]}, column {names[entry]} must be {rows[0, entry]:g} as in row {numbers[label][0]} of the same "
                f"demonstration, got {rows[step, entry]:g}"
            )
    return torch.from_numpy(np.stack([rows[0] for rows in columns.values()]))


def _csv_numbers(row: list[str], header: list[str], number: int) -> list[float]:
    if len(row) != len(header):
        raise DemonstrationError(f"row {number} must have {len(header)} columns, got {len(row)}")
    numbers = []
    for name, cell in zip(header[1:], row[1:], strict=True):
        try:
            numbers.append(float(cell))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]):
            raise DemonstrationError(f"row {number}, column {name} must be a finite number, got {cell!r}")
    return numbers


def _check_csv_lengths(samples: dict[str, np.ndarray]) -> None:
    lengths = {label: len(rows) for label, rows in samples.items()}
    first_label, expected = next(iter(lengths.items()))
    if expected < 2:
        raise DemonstrationError(f"demonstration {first_label} must have at least two rows, got {expected}")
    for label, length in lengths.items():
        if length != expected:
            raise DemonstrationError(
                f"demonstration {label} must have {expected} rows like demonstration {first_label}, got {length}; "
                "scripts/align_demonstrations.py makes them one length"
            )


def _csv_time_step(times: np.ndarray, row_numbers: list[list[int]]) -> float:
    """The one time step of all demonstrations; times is (N, T+1)."""
    time_steps = np.diff(times)
    expected = times[0, 1] - times[0, 0]
    if expected <= 0:
        raise DemonstrationError(f"row {row_numbers[0][1]}, column time must increase, got a step of {expected:g} s")
    unequal = np.argwhere(np.abs(time_steps - expected) > TIME_STEP_TOLERANCE * expected)
    if len(unequal):
        demonstration, step = unequal[0]
        raise DemonstrationError(
            f"row {row_numbers[demonstration][step + 1]}, column time must follow the row before it by "
            f"{expected:g} s, got {time_steps[demonstration, step]:g} s"
        )
    return float((times[:, -1] - times[:, 0]).mean() / (times.shape[1] - 1))
