"""The LASA handwriting set: MATLAB files of strokes that people drew on a tablet.

Source: Khansari-Zadeh and Billard 2011.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from torch_pmil.demonstrations.errors import TEXT_BYTES, DemonstrationError, content_of, readable
from torch_pmil.demonstrations.formats.entries import choose
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import MIB

GROUPS = {"pos": ("x", "y"), "vel": ("dx", "dy")}
UNITS = {"pos": "m", "vel": "m/s"}
HEADER, PACKED = 128, 15  # bytes before the first element of a file; number of a packed element
ELEMENTS = 1000  # of a file; those of the set have a handful
METRES = 1e-3  # of a unit of the files, which hold mm and mm/s


def read_lasa(path: Path, keys: Sequence[str] = ()) -> Recordings:
    """The strokes of a shape: position over time, and velocity if it is asked for.

    Args:
        path: a .mat file of the set.
        keys: ``pos`` for x and y, ``vel`` for dx and dy, or names of those; none for ``pos``.

    Raises:
        DemonstrationError: it is no such file.
        OSError: it cannot be read.
    """
    if path.is_dir():
        shapes = ", ".join(sorted(file.stem for file in path.glob("*.mat")))
        raise DemonstrationError(
            f"a folder of shapes: name one of them, as {path / 'NAME'}; found {shapes}"
        )
    file = content_of(path, TEXT_BYTES)
    with readable("MATLAB file", zlib.error, MatReadError):
        _check_unpacked(file)
        content = loadmat(io.BytesIO(file), variable_names=["demos"], simplify_cells=True)
    strokes = content.get("demos", [])
    strokes = strokes if isinstance(strokes, list) else [strokes]
    if not strokes:
        raise DemonstrationError("a LASA file must hold a list demos, found none")
    entries = choose(GROUPS, keys, ["pos"])
    labels = tuple(str(number) for number in range(1, len(strokes) + 1))
    read = sorted({"pos", *(entry.key for entry in entries)})
    arrays = [_stroke(label, stroke, read) for label, stroke in zip(labels, strokes, strict=True)]
    values = [
        METRES * np.stack([stroke[entry.key][entry.column] for entry in entries], 1)
        for stroke in arrays
    ]
    return Recordings(
        labels,
        tuple(torch.from_numpy(stroke["t"]) for stroke in arrays),
        tuple(map(torch.from_numpy, values)),
        tuple(entry.name for entry in entries),
        units=tuple(UNITS[entry.key] for entry in entries),
        format="LASA handwriting",
    )


def _check_unpacked(content: bytes) -> None:
    """Unpack the packed elements of a file piece by piece, and refuse one that goes on and on."""
    place, total = HEADER, 0
    order = "<" if content[HEADER - 2 : HEADER] == b"IM" else ">"
    for _ in range(ELEMENTS):
        if place + 8 > len(content):
            return
        kind, size = struct.unpack_from(f"{order}2I", content, place)
        place += 8
        if kind == PACKED:
            unpacking, left = zlib.decompressobj(), content[place : place + size]
            while left and not unpacking.eof and total <= TEXT_BYTES:
                total += len(unpacking.decompress(left, MIB))
                left = unpacking.unconsumed_tail
        if total > TEXT_BYTES:
            raise DemonstrationError(f"must have at most {TEXT_BYTES} bytes unpacked, got more")
        place += size
    raise DemonstrationError(f"must have at most {ELEMENTS} elements, got more")


def _stroke(label: str, stroke: object, keys: Sequence[str]) -> Mapping[str, np.ndarray]:
    """Time (T,) and the arrays (2, T) of a stroke."""
    held = stroke if isinstance(stroke, dict) else {}
    for key in ("t", *keys):
        if not isinstance(held.get(key), np.ndarray) or held[key].dtype.kind not in "fiu":
            raise DemonstrationError(
                f"demonstration {label} must hold numbers {key}, found {sorted(map(str, held))}"
            )
        shape = held["t"].shape if key == "t" else (2, held["t"].size)
        if held[key].shape != shape or held["t"].ndim != 1:
            raise DemonstrationError(
                f"demonstration {label}, {key} must have shape {shape}, got {held[key].shape}"
            )
    return {key: held[key].astype(np.float64) for key in ("t", *keys)}
