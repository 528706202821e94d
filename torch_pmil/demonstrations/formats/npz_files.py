"""NPZ files written by ``Demonstrations.save``."""

from __future__ import annotations

import io
import math
import struct
import tokenize
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_pmil.demonstrations.dataset import Demonstrations
from torch_pmil.demonstrations.errors import (
    FILE_BYTES,
    HEAD,
    DemonstrationError,
    check_count,
    check_kind,
    readable,
)
from torch_pmil.demonstrations.formats.entries import choose
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import read_bytes, read_zip

ARRAYS = ("positions", "time_step", "names", "targets", "target_names")
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(path: Path, keys: Sequence[str] = ()) -> Recordings:
    """The demonstrations of an NPZ file as recordings, numbered from 1."""
    shown = load_npz(path, keys)
    count, samples, _ = shown.positions.shape
    labels = tuple(str(number) for number in range(1, count + 1))
    times = shown.time_step * torch.arange(samples, dtype=torch.float64)
    return Recordings(
        labels,
        count * (times,),
        tuple(shown.positions),
        shown.names,
        shown.targets,
        shown.target_names,
        format="NPZ",
    )


def load_npz(path: Path, keys: Sequence[str] = ()) -> Demonstrations:
    """The demonstrations of an NPZ file, with all entries or those that keys name."""
    content = read_bytes(path, FILE_BYTES)
    check_kind("an NPZ file", content[:HEAD], b"PK\3\4")
    with readable("NPZ file without object arrays", struct.error, tokenize.TokenError):
        members = read_zip(content, FILE_BYTES, stored=False)
        arrays = {
            name: _array(name, members[f"{name}.npy"])
            for name in ARRAYS
            if f"{name}.npy" in members
        }
    _check(arrays)
    names, targets = arrays["names"].tolist(), arrays.get("targets")
    columns: slice | list[int] = slice(None)
    if keys:
        entries = choose({name: [name] for name in names}, keys, ())
        columns = [names.index(entry.name) for entry in entries]
    return Demonstrations(
        _tensor(arrays["positions"])[..., columns],
        arrays["time_step"].item(),
        tuple(np.array(names)[columns]),
        None if targets is None else _tensor(targets),
        tuple(arrays.get("target_names", ())),
    )


def _tensor(numbers: np.ndarray) -> Tensor:
    """Numbers of any precision and byte order, which PyTorch does not take."""
    return torch.from_numpy(numbers.astype(np.float64))


def _array(name: str, content: bytes) -> np.ndarray:
    """An array that is no larger than its bytes."""
    file = io.BytesIO(content)
    shape, _, kind = HEADERS[np.lib.format.read_magic(file)](file)
    numbers = math.prod(shape)
    check_count("numbers", numbers)
    if kind.kind != "O" and not 0 < numbers * kind.itemsize == len(content) - file.tell():
        raise ValueError(
            f"array {name} must have the bytes of {shape} of {kind}, got "
            f"{len(content) - file.tell()}"
        )
    return np.load(io.BytesIO(content), allow_pickle=False)


def _check(arrays: dict[str, np.ndarray]) -> None:
    for name in ("positions", "time_step", "names"):
        if name not in arrays:
            raise DemonstrationError(f"array {name} is missing, found {sorted(arrays)}")
    if arrays["positions"].dtype.kind not in "fiu" or arrays["time_step"].dtype.kind not in "fiu":
        raise DemonstrationError("arrays positions and time_step must hold real numbers")
    if arrays["time_step"].shape != () or not _is_text(arrays["names"]):
        raise DemonstrationError("array time_step must be one number and names a list of text")
    check_count("entries", len(arrays["names"]))
    targets, target_names = arrays.get("targets"), arrays.get("target_names", np.array([], str))
    real = targets is None or targets.dtype.kind in "fiu"
    if not real or not _is_text(target_names):
        raise DemonstrationError(
            "array targets must hold real numbers and target_names be a list of text"
        )
    check_count("entries", len(target_names))


def _is_text(names: np.ndarray) -> bool:
    return names.ndim == 1 and names.dtype.kind == "U"
