"""Files and folders of demonstrations, whatever their format."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from torch_pmil.demonstrations.dataset import TIME_STEP_TOLERANCE, Demonstrations
from torch_pmil.demonstrations.errors import DemonstrationError, within
from torch_pmil.demonstrations.formats.csv_files import read_csv
from torch_pmil.demonstrations.formats.hdf5 import read_hdf5
from torch_pmil.demonstrations.formats.lasa import read_lasa
from torch_pmil.demonstrations.formats.lerobot import read_lerobot
from torch_pmil.demonstrations.formats.npz_files import load_npz, read_npz
from torch_pmil.demonstrations.recordings import Recordings

FILES = {
    ".npz": read_npz,
    ".csv": read_csv,
    ".mat": read_lasa,
    ".hdf5": read_hdf5,
    ".h5": read_hdf5,
    ".parquet": read_lerobot,
}
FOLDERS = {  # by what they hold
    "meta/info.json": read_lerobot,
    "data/metadata.json": read_hdf5,
    "metadata.json": read_hdf5,
    "*.csv": read_csv,
    "*.mat": read_lasa,
}


def load_recordings(
    path: str | os.PathLike[str],
    *,
    keys: Sequence[str] = (),
    names: Sequence[str] = (),
    time_step: float | None = None,
) -> Recordings:
    """Load recordings with any number of samples at any times.

    Actions are never read, and nothing in the file is executed.

    Args:
        path: a file or folder: NPZ as ``Demonstrations.save`` writes it; CSV, a file with the
            columns ``demonstration,time,NAME,...`` or a folder with a file ``time,NAME,...`` for
            each demonstration; a shape of the LASA handwriting set, as ``DataSet/Angle`` or with
            its suffix .mat; a Minari data set (HDF5); a robomimic file (.hdf5); a LeRobot data set
            or a .parquet file of one.
        keys: what to read of it, in that order: keys or columns of the file, or single entries by
            name. None for all of an NPZ or CSV file, the positions of a LASA file,
            ``observation.state`` of LeRobot's, and what was observed in the others if it is one
            data set.
        names: of the entries, in place of those that the file has.
        time_step: seconds between samples, for files without times: Minari's and robomimic's.

    Returns:
        The recordings, in the order of the file.

    Raises:
        DemonstrationError: the file is malformed, or an argument does not fit it; the message says
            where, what was expected, what came.
        ImportError: the format needs a library that is missing.
        OSError: the file cannot be read.
    """
    path = _found(Path(path))
    with within(path):
        recordings = _read(path, keys, time_step)
        return replace(recordings, names=tuple(names)) if names else recordings


def load_demonstrations(
    path: str | os.PathLike[str],
    time_step: float | None = None,
    *,
    keys: Sequence[str] = (),
    names: Sequence[str] = (),
) -> Demonstrations:
    """Load demonstrations that all have equally many samples at one time step.

    The file is of any kind that :func:`load_recordings` reads.

    Args:
        path: of the file or folder.
        time_step: seconds between samples that the file must have, or has if it holds no times;
            None takes what the file says.
        keys, names: as for :func:`load_recordings`.

    Returns:
        The demonstrations of the file.

    Raises:
        DemonstrationError: the file is malformed, or lengths or time steps differ; the message
            names file and place.
        ImportError: the format needs a library that is missing.
        OSError: the file cannot be read.
    """
    path = _found(Path(path))
    with within(path):
        if path.suffix == ".npz":
            demonstrations = load_npz(path, keys)
        else:
            told = time_step if _reader(path) is read_hdf5 else None
            demonstrations = _read(path, keys, told).demonstrations()
        if time_step is not None and not math.isclose(
            demonstrations.time_step, time_step, rel_tol=TIME_STEP_TOLERANCE
        ):
            raise DemonstrationError(
                f"time_step must be {time_step} s, got {demonstrations.time_step} s"
            )
        return replace(demonstrations, names=tuple(names)) if names else demonstrations


def _found(path: Path) -> Path:
    """The path, or the file of the LASA shape that it names without its suffix."""
    if not path.exists() and (shape := path.with_name(f"{path.name}.mat")).is_file():
        return shape
    path.stat()  # raises if it is missing
    return path


def _read(path: Path, keys: Sequence[str], time_step: float | None) -> Recordings:
    reader = _reader(path)
    if reader is read_hdf5:
        return read_hdf5(path, keys, time_step)
    if time_step is not None:
        raise DemonstrationError(
            f"time_step must be left out: the file has times of its own, got {time_step}"
        )
    return reader(path, keys)


def _reader(path: Path) -> Callable[..., Recordings]:
    if path.is_dir():
        fitting = [reader for held, reader in FOLDERS.items() if any(path.glob(held))]
        if not fitting:
            raise DemonstrationError(
                f"a folder of demonstrations must hold one of {', '.join(FOLDERS)}, got none"
            )
        return fitting[0]
    if path.suffix not in FILES:
        raise DemonstrationError(
            f"demonstrations must be a {', '.join(list(FILES)[:-1])} or {list(FILES)[-1]} file, or "
            f"a folder of them, got {path.suffix or 'no suffix'}"
        )
    return FILES[path.suffix]
