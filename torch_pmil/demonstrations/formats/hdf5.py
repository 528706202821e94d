"""HDF5: data sets of Minari, and of robomimic and those that write as it does."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_pmil.demonstrations.errors import (
    DemonstrationError,
    check_demonstrations,
    opened_set,
    optional,
    readable,
)
from torch_pmil.demonstrations.formats.entries import choose, columns_of, names_of, natural_order
from torch_pmil.demonstrations.formats.hdf5_storage import check_storage, member
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import read_json, short


class _Layout(NamedTuple):
    format: str
    root: str
    prefix: str  # of the groups that are demonstrations
    observed: str  # in each of them


ROBOMIMIC = _Layout("robomimic", "data", "demo_", "obs")
MINARI = _Layout("Minari", "", "episode_", "observations")
KINDS = ("f", "i", "u")  # of numbers
DATASETS = 2000  # beside each other in a demonstration


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
    kind = readable("HDF5 file", zlib.error)
    with opened_set(path) as file, kind, h5py.File(file) as content:
        layout = _layout(content)
        root = _root(content, layout)
        labels = _labels(root, layout)
        step = time_step if time_step is not None else _time_step(root)
        first = _datasets(member(root, f"{labels[0]}/{layout.observed}"))
        groups = {key: names_of(key, data.shape) for key, data in first.items()}
        entries = choose(groups, keys, _only(first))
        needed = sorted({entry.key for entry in entries})
        shown = [_needed(root, label, layout.observed, first, needed) for label in labels]
        check_storage([one[key] for one in shown for key in needed])
        arrays = [_arrays(label, one) for label, one in zip(labels, shown, strict=True)]
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
        if _labels(_root(content, layout), layout):
            return layout
    raise DemonstrationError(
        "an HDF5 file must hold groups data/demo_N (robomimic) or episode_N (Minari), found "
        f"{short(sorted(content))}"
    )


def _root(content: Any, layout: _Layout) -> Any:
    return member(content, layout.root) if layout.root else content


def _labels(root: Any, layout: _Layout) -> list[str]:
    """Names of the demonstrations, in their order."""
    if not hasattr(root, "keys"):
        return []
    labels = [name for name in root if name.startswith(layout.prefix)]
    check_demonstrations(len(labels))
    return sorted(labels, key=natural_order)


def _time_step(root: Any) -> float:
    """Seconds between samples, by the control frequency that a robomimic file states."""
    try:
        return 1 / json.loads(root.attrs["env_args"])["env_kwargs"]["control_freq"]
    except (LookupError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise DemonstrationError(
            "time_step must be given, in s: the file does not say how often it was sampled"
        ) from error


def _datasets(observed: Any) -> dict[str, Any]:
    """Data sets of one number or one list of numbers a sample, by their path."""
    found: dict[str, Any] = {}
    seen: list[str] = []

    def visit(name: str, node: Any) -> None:
        if getattr(node, "ndim", 0) in (1, 2) and node.dtype.kind in KINDS:
            found[name] = node
        seen.append(name)
        if len(seen) > DATASETS:
            raise DemonstrationError(f"a demonstration must hold at most {DATASETS} data sets")

    if hasattr(observed, "visititems"):
        observed.visititems(visit)
    elif observed is not None:
        visit(MINARI.observed, observed)
    return found


def _only(datasets: dict[str, Any]) -> Sequence[str]:
    return list(datasets) if len(datasets) == 1 else ()


def _needed(
    root: Any, label: str, observed: str, first: dict[str, Any], keys: Sequence[str]
) -> dict[str, Any]:
    """The data sets of a demonstration that are read."""
    datasets = {}
    for key in keys:
        path = f"{label}/{observed}" if key == observed else f"{label}/{observed}/{key}"
        data = member(root, path)
        same = getattr(getattr(data, "dtype", None), "kind", "") in KINDS
        if not same or data.shape[1:] != first[key].shape[1:] or data.ndim != first[key].ndim:
            raise DemonstrationError(
                f"{label} must hold {key} in the shape of the first demonstration"
            )
        datasets[key] = data
    return datasets


def _arrays(label: str, datasets: dict[str, Any]) -> dict[str, np.ndarray]:
    arrays = {key: data[()] for key, data in datasets.items()}
    first = next(iter(arrays))
    for key, array in arrays.items():
        if len(array) != len(arrays[first]):
            raise DemonstrationError(
                f"{label}, {key} must have {len(arrays[first])} samples like {first}, got "
                f"{len(array)}"
            )
    return arrays
