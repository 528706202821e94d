"""The LASA handwriting set: MATLAB files of strokes that people drew on a tablet.

Source: Khansari-Zadeh and Billard 2011.

SciPy allocates the shape that an array of a MATLAB file states, even if only a few bytes follow.
Here no array may have more numbers, cells or structures than bytes. SciPy also ignores the stated
end of an array, so the check walks from element to element as SciPy does.
"""

from __future__ import annotations

import io
import itertools
import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy

from torch_pmil.demonstrations.errors import (
    HEAD,
    TEXT_BYTES,
    DemonstrationError,
    check_count,
    check_kind,
    readable,
)
from torch_pmil.demonstrations.formats.entries import choose, recordings_of
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import MIB, read_bytes

GROUPS = {"pos": ("x", "y"), "vel": ("dx", "dy")}
UNITS = {"pos": "m", "vel": "m/s"}
METRES = 1e-3  # of a unit of the files, which hold mm and mm/s
HEADER = 128  # bytes before the first element of a MATLAB file
PACKED, ARRAY = 15, 14  # numbers of elements
FLAGS = 16  # bytes at the beginning of an array


def read_lasa(path: Path, keys: Sequence[str] = ()) -> Recordings:
    """The strokes of a shape, from a .mat file of the set.

    ``keys`` are ``pos`` for x and y (the default), ``vel`` for dx and dy, or single names. Raises
    DemonstrationError if the file is malformed.
    """
    if path.is_dir():
        shapes = ", ".join(
            sorted(file.stem for file in path.iterdir() if file.suffix.lower() == ".mat")
        )
        raise DemonstrationError(
            f"a folder of shapes: name one of them, as {path / 'NAME'}; found {shapes}"
        )
    file = read_bytes(path, TEXT_BYTES)
    check_kind("a MATLAB file", file[:HEAD], b"MATLAB 5")
    with readable("MATLAB file", zlib.error, struct.error, scipy.io.matlab.MatReadError):
        _check_arrays(file)
        content = scipy.io.loadmat(io.BytesIO(file), variable_names=["demos"], simplify_cells=True)
    strokes = content.get("demos", [])
    strokes = strokes if isinstance(strokes, list) else [strokes]
    if not strokes:
        raise DemonstrationError("a LASA file must hold a list demos, found none")
    entries = choose(GROUPS, keys, ["pos"])
    labels = [str(number) for number in range(1, len(strokes) + 1)]
    read = sorted({"pos", *(entry.key for entry in entries)})
    arrays = [_stroke(label, stroke, read) for label, stroke in zip(labels, strokes, strict=True)]
    return recordings_of(
        labels,
        (stroke["t"] for stroke in arrays),
        (
            METRES * np.stack([stroke[entry.key][entry.column] for entry in entries], 1)
            for stroke in arrays
        ),
        entries,
        units=tuple(UNITS[entry.key] for entry in entries),
        format="LASA handwriting",
    )


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


def _check_arrays(content: bytes) -> None:
    """Raise DemonstrationError if there are too many arrays, or one is larger than its bytes.

    ``struct`` or ``zlib`` raises at damage.
    """
    order = "<" if content[HEADER - 2 : HEADER] == b"IM" else ">"
    arrays = 0
    for element in _elements(content, order):
        place = 0
        while place + 8 <= len(element):
            kind, size = struct.unpack_from(f"{order}2I", element, place)
            if kind == ARRAY and size:
                arrays += 1
                place = _behind_shape(element, place + 8, size, order)
            else:
                place = _next(element, place, order)
            check_count("arrays", arrays)


def _elements(content: bytes, order: str) -> Iterator[bytes]:
    """The elements of a file, unpacked piece by piece up to the limit."""
    place, total = HEADER, 0
    for count in itertools.count(1):
        if place + 8 > len(content):
            return
        check_count("elements", count)
        kind, size = struct.unpack_from(f"{order}2I", content, place)
        if kind != PACKED:
            yield content[place : place + 8 + size]
        else:
            unpacking, left, parts = zlib.decompressobj(), content[place + 8 : place + 8 + size], []
            while left and not unpacking.eof:
                parts.append(unpacking.decompress(left, MIB))
                total, left = total + len(parts[-1]), unpacking.unconsumed_tail
                check_count("unpacked bytes", total)
            yield b"".join(parts)
        place += 8 + size


def _next(element: bytes, place: int, order: str) -> int:
    """The place behind an element; a small one has eight bytes in all."""
    kind, size = struct.unpack_from(f"{order}2I", element, place)
    return place + 8 + (0 if kind >> 16 else -(-size // 8) * 8)


def _behind_shape(element: bytes, place: int, size: int, order: str) -> int:
    """Check the shape of an array, and return the place behind it."""
    place += FLAGS
    kind, length = struct.unpack_from(f"{order}2I", element, place)
    at, length = (place + 4, kind >> 16) if kind >> 16 else (place + 8, length)
    shape = struct.unpack_from(f"{order}{min(length, size) // 4}i", element, at)
    if min(shape, default=0) < 0 or math.prod(shape) > size:
        raise DemonstrationError(f"an array of {size} bytes cannot have the shape {shape[:9]}")
    return _next(element, place, order)
