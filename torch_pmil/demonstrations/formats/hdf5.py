"""HDF5: data sets of Minari, and of robomimic and those that write as it does."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_pmil.demonstrations.errors import (
    DemonstrationError,
    check_count,
    opened_set,
    optional,
    readable,
)
from torch_pmil.demonstrations.formats.entries import choose, columns_of, names_of, natural_order
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import read_json


class _Layout(NamedTuple):
    format: str
    root: str
    prefix: str  # of the groups that are demonstrations
    observed: str  # in each of them


ROBOMIMIC = _Layout("robomimic", "data", "demo_", "obs")
MINARI = _Layout("Minari", "/", "episode_", "observations")


def read_hdf5(path: Path, keys: Sequence[str] = (), time_step: float | None = None) -> Recordings:
    """The observations of a robomimic file or of a Minari data set.

    They lie in ``data/demo_N/obs`` and in ``episode_N/observations``.

    Args:
        path: of the file, or the folder of a Minari data set.
        keys: data sets below what was observed, or single entries as ``KEY_0``; none where there is
            only one data set.
        time_step: seconds between samples; None for what a robomimic file says itself,
            ``control_freq`` in its ``env_args``.

    Raises:
        DemonstrationError: the file is malformed, keys are not in it, or nothing says the time
            step.
        ImportError: h5py is missing.
        OSError: the file cannot be read.
    """
    path = _main_file(path) if path.is_dir() else path
    h5py = optional("h5py")
    with opened_set(path) as file, readable("HDF5 file"), h5py.File(file) as content:
        layout = _layout(content)
        root = content[layout.root]
        labels = sorted(
            (name for name in root if name.startswith(layout.prefix)), key=natural_order
        )
        step = time_step if time_step is not None else _time_step(root)
        observed = [_datasets(root[label].get(layout.observed, {})) for label in labels]
        groups = {key: names_of(key, data.shape) for key, data in observed[0].items()}
        entries = choose(groups, keys, _only(observed[0]))
        needed = sorted({entry.key for entry in entries})
        check_count(sum(one[key].size for one in observed for key in needed if key in one))
        arrays = [
            _arrays(label, data, needed, observed[0])
            for label, data in zip(labels, observed, strict=True)
        ]
    values = [torch.from_numpy(columns_of(one, entries)) for one in arrays]
    times = tuple(step * torch.arange(len(one), dtype=torch.float64) for one in values)
    return Recordings(
        tuple(labels),
        times,
        tuple(values),
        tuple(entry.name for entry in entries),
        format=layout.format,
    )


def _main_file(folder: Path) -> Path:
    """The file of a Minari data set."""
    folder = folder / "data" if (folder / "data").is_dir() else folder
    with readable("Minari data set"):
        metadata = read_json(folder / "metadata.json")
    kept = metadata.get("data_format") if isinstance(metadata, dict) else None
    if kept != "hdf5":
        raise DemonstrationError(f"data_format of a Minari data set must be hdf5, got {kept}")
    return folder / "main_data.hdf5"


def _layout(content: Any) -> _Layout:
    for layout in (ROBOMIMIC, MINARI):
        if layout.root in content and any(
            name.startswith(layout.prefix) for name in content[layout.root]
        ):
            return layout
    raise DemonstrationError(
        "an HDF5 file must hold groups data/demo_N (robomimic) or episode_N (Minari), found "
        f"{sorted(content)}"
    )


def _time_step(root: Any) -> float:
    """Seconds between samples, by the control frequency that a robomimic file states."""
    try:
        return 1 / json.loads(root.attrs["env_args"])["env_kwargs"]["control_freq"]
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise DemonstrationError(
            "time_step must be given, in s: the file does not say how often it was sampled"
        ) from error


def _datasets(observed: Any) -> dict[str, Any]:
    """Data sets of one number or one list of numbers a sample, by their path."""
    found: dict[str, Any] = {}

    def visit(name: str, node: Any) -> None:
        if getattr(node, "ndim", 0) in (1, 2) and node.dtype.kind in "fiu":
            found[name] = node

    if hasattr(observed, "visititems"):
        observed.visititems(visit)
    else:
        visit("observations", observed)
    return found


def _only(datasets: dict[str, Any]) -> Sequence[str]:
    return list(datasets) if len(datasets) == 1 else ()


def _arrays(
    label: str, datasets: dict[str, Any], keys: Sequence[str], first: dict[str, Any]
) -> dict[str, np.ndarray]:
    arrays = {}
    for key in keys:
        if key not in datasets or datasets[key].shape[1:] != first[key].shape[1:]:
            raise DemonstrationError(
                f"{label} must hold {key} in the shape of the first demonstration"
            )
        arrays[key] = datasets[key][()]
        if len(arrays[key]) != len(arrays[keys[0]]):
            raise DemonstrationError(
                f"{label}, {key} must have {len(arrays[keys[0]])} samples like {keys[0]}, got "
                f"{len(arrays[key])}"
            )
    return arrays
