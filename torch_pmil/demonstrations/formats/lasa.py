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
from torch_pmil.demonstrations.formats.matlab_arrays import check_arrays
from torch_pmil.demonstrations.recordings import Recordings

GROUPS = {"pos": ("x", "y"), "vel": ("dx", "dy")}
UNITS = {"pos": "m", "vel": "m/s"}
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
    with readable("MATLAB file", zlib.error, struct.error, MatReadError):
        check_arrays(file)
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
