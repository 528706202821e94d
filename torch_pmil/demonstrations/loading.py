"""Files and folders of demonstrations in any format, and those that come with the package."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

from torch_pmil.demonstrations.dataset import TIME_STEP_TOLERANCE, Demonstrations
from torch_pmil.demonstrations.errors import TIME_STEP, DemonstrationError, within
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
    """Load recordings with any number of samples at any times, in the order of the file.

    Actions are never read, and nothing in the file is executed.

    Args:
        path: a file or folder: NPZ from ``Demonstrations.save``; CSV, a file with the columns
            ``demonstration,time,NAME,...`` or a folder with a file ``time,NAME,...`` for each
            demonstration; a shape of the LASA handwriting set, as ``DataSet/Angle`` with or without
            its suffix .mat; a Minari data set (HDF5); a robomimic file (.hdf5); a LeRobot data set
            or a .parquet file of one.
        keys: what to read, in that order: keys or columns of the file, or single entries by name.
            By default all of an NPZ or CSV file, the positions of a LASA file,
            ``observation.state`` of LeRobot, and the observation of the others if it is one data
            set.
        names: of the entries, in place of those in the file.
        time_step: seconds between samples, for files that do not say: Minari and some robomimic.

    Raises:
        DemonstrationError: the file is malformed, or an argument does not fit it.
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
    """Load demonstrations that have the same number of samples and one time step.

    Arguments and errors are those of :func:`load_recordings`. If the file holds times, their step
    must be ``time_step``, unless that is None; a Minari or robomimic file that does not say is
    taken to have that step.

    Raises:
        DemonstrationError: also if lengths or time steps differ.
    """
    path = _found(Path(path))
    with within(path):
        if path.suffix.lower() == ".npz":
            demonstrations = load_npz(path, keys)
        else:
            given = time_step if _reader(path) is read_hdf5 else None
            demonstrations = _read(path, keys, given).demonstrations()
        if time_step is not None and not math.isclose(
            demonstrations.time_step, time_step, rel_tol=TIME_STEP_TOLERANCE
        ):
            raise DemonstrationError(
                f"time_step must be {time_step} s, got {demonstrations.time_step} s"
            )
        return replace(demonstrations, names=tuple(names)) if names else demonstrations


def shipped_demonstrations(name: str = "double_pendulum") -> Demonstrations:
    """The demonstrations that come with the package, by name.

    * ``double_pendulum``: five swing-ups, [x1, y1, x2, y2] in m, 10 Hz, 2.5 s
    * ``double_pendulum_targets``: three motions to each of three places [x, y] of the tip, likewise
    * ``gym_pendulum``: five swing-ups of Pendulum-v1, tip [x, y] in m, 10 Hz, 4 s
    * ``inverted_pendulum``: ten recoveries of InvertedPendulum-v5, [x_cart, x_tip, z_tip] in m,
      25 Hz, 2 s
    * ``pendubot``, ``acrobot``: five swing-ups by the motor in the shoulder, and in the elbow,
      [x1, y1, x2, y2] in m, 25 Hz, 3 s
    * ``cart_pole``: five swing-ups, [x_cart, x_tip, z_tip] in m, 10 Hz, 3 s
    * ``biorob``: three strikes, led by hand and aligned in time, [q, dq] of yaw, shoulder and elbow
      in rad and rad/s, 10 Hz, 1.8 s
    * ``biorob_targets``: two such strikes at each of three balls; targets are the balls' places
      [y, z] in the hitting plane, m

    Raises:
        DemonstrationError: there are no demonstrations of that name.

    Example:
        >>> shipped_demonstrations().positions.shape
        torch.Size([5, 26, 4])
    """
    data = resources.files("torch_pmil.demonstrations").joinpath("data")
    shipped = {Path(file.name).stem: file for file in data.iterdir() if file.name.endswith(".npz")}
    if name not in shipped:
        raise DemonstrationError(
            f"shipped demonstrations must be one of {sorted(shipped)}, got {name}"
        )
    with resources.as_file(shipped[name]) as path:
        return load_demonstrations(path)


def _found(path: Path) -> Path:
    """The path, or the file of a LASA shape named without its suffix."""
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
            f"{TIME_STEP} must be left out: the file has times of its own, got {time_step}"
        )
    return reader(path, keys)


def _reader(path: Path) -> Callable[..., Recordings]:
    if path.is_dir():
        fitting = [reader for held, reader in FOLDERS.items() if _holds(path, held)]
        if not fitting:
            raise DemonstrationError(
                f"a folder of demonstrations must hold one of {', '.join(FOLDERS)}, got none"
            )
        return fitting[0]
    suffix = path.suffix.lower()
    if suffix not in FILES:
        raise DemonstrationError(
            f"demonstrations must be a {', '.join(list(FILES)[:-1])} or {list(FILES)[-1]} file, or "
            f"a folder of them, got {path.suffix or 'no suffix'}"
        )
    return FILES[suffix]


def _holds(folder: Path, held: str) -> bool:
    """Whether a folder holds a file, or one with a suffix in letters of any case."""
    if held.startswith("*"):
        return any(file.suffix.lower() == held[1:] for file in folder.iterdir())
    return (folder / held).exists()
