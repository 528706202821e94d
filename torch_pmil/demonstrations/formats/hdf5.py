"""HDF5: data sets of Minari, and of robomimic and compatible writers.

HDF5 follows links into other files of the machine, and unpacks a chunk to any size. The checks here
require that the numbers are in the file itself, and unpack to no more than their stated size.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_pmil.demonstrations.dataset import TIME_STEP_TOLERANCE
from torch_pmil.demonstrations.errors import (
    MOST,
    TIME_STEP,
    DemonstrationError,
    check_count,
    opened_set,
    optional,
    readable,
)
from torch_pmil.demonstrations.formats.entries import (
    choose,
    columns_of,
    names_of,
    natural_order,
    recordings_of,
)
from torch_pmil.demonstrations.recordings import Recordings
from torch_pmil.files import MIB, read_json, short


class _Layout(NamedTuple):
    format: str
    root: str
    prefix: str  # of the groups that are demonstrations
    observed: str  # in each of them


ROBOMIMIC = _Layout("robomimic", "data", "demo_", "obs")
MINARI = _Layout("Minari", "", "episode_", "observations")
KINDS = ("f", "i", "u")  # of numbers
GZIP, SHUFFLE, CHECKSUM, LZF = 1, 2, 3, 32_000  # numbers of HDF5's filters
FILTERS = {GZIP, SHUFFLE, CHECKSUM, LZF}
LZF_BYTES = 4 * MIB  # of a chunk, which unpacks to at most 88 times that


def read_hdf5(path: Path, keys: Sequence[str] = (), time_step: float | None = None) -> Recordings:
    """The observations of a robomimic file or of a Minari data set.

    They are in ``data/demo_N/obs`` and in ``episode_N/observations``.

    Args:
        path: of the file, or the folder of a Minari data set.
        keys: data sets of the observation, or single entries as ``KEY_0``; not needed if there is
            only one data set.
        time_step: seconds between samples; None for ``control_freq`` in the ``env_args`` of a
            robomimic file.

    Raises:
        DemonstrationError: the file is malformed or lacks a key, or the time step is unknown or not
            that of the file.
        ImportError: h5py is missing.
    """
    path = _main_file(path) if path.is_dir() else path
    h5py = optional("h5py")
    with (
        opened_set(path, "an HDF5 file", b"\x89HDF") as file,
        readable("HDF5 file", zlib.error),
        h5py.File(file) as content,
    ):
        layout, root, labels = _layout(content)
        step = _time_step(root, time_step)
        first = _datasets(_member(root, f"{labels[0]}/{layout.observed}"))
        if not first:
            raise DemonstrationError(
                f"{labels[0]}/{layout.observed} must hold data sets of numbers, found none"
            )
        groups = {
            key: names_of(key, data.shape)
            for key, data in first.items()
            if key in keys or len(first) == 1 or math.prod(data.shape[1:]) <= MOST["entries"]
        }
        entries = choose(groups, keys, list(first) if len(first) == 1 else ())
        needed = sorted({entry.key for entry in entries})
        shown = [_needed(root, label, layout.observed, first, needed) for label in labels]
        _check_storage([one[key] for one in shown for key in needed])
        arrays = [{key: data[()] for key, data in one.items()} for one in shown]
    values = [columns_of(one, entries) for one in arrays]
    times = (step * np.arange(len(one), dtype=np.float64) for one in values)
    return recordings_of(labels, times, values, entries, format=layout.format)


def _main_file(folder: Path) -> Path:
    """The file of a Minari data set."""
    folder = folder / "data" if (folder / "data").is_dir() else folder
    with readable("Minari data set"):
        metadata = read_json(folder / "metadata.json")
    kept = metadata.get("data_format") if isinstance(metadata, dict) else None
    if kept != "hdf5":
        raise DemonstrationError(f"data_format of a Minari data set must be hdf5, got {kept}")
    return folder / "main_data.hdf5"


def _layout(content: Any) -> tuple[_Layout, Any, list[str]]:
    """The layout, its root, and names of the demonstrations in order."""
    for layout in (ROBOMIMIC, MINARI):
        root = _member(content, layout.root)
        held = root if hasattr(root, "keys") else ()
        labels = [name for name in held if name.startswith(layout.prefix)]
        check_count("demonstrations", len(labels))
        if labels:
            return layout, root, sorted(labels, key=natural_order)
    raise DemonstrationError(
        "an HDF5 file must hold groups data/demo_N (robomimic) or episode_N (Minari), found "
        f"{short(sorted(content))}"
    )


def _time_step(root: Any, given: float | None) -> float:
    """Seconds between samples, from the control frequency in a robomimic file, or as given."""
    try:
        own = 1 / json.loads(root.attrs["env_args"])["env_kwargs"]["control_freq"]
    except (LookupError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        if given is not None:
            return given
        raise DemonstrationError(
            f"{TIME_STEP} must be given, in s: the file does not say how often it was sampled"
        ) from error
    if given is not None and not math.isclose(own, given, rel_tol=TIME_STEP_TOLERANCE):
        raise DemonstrationError(
            f"{TIME_STEP} must be left out: by its control_freq the file has a sample every "
            f"{own:g} s, got {given}"
        )
    return own


def _datasets(observed: Any) -> dict[str, Any]:
    """Data sets of numbers or lists of numbers, by their path."""
    found: dict[str, Any] = {}
    seen: list[str] = []

    def visit(name: str, node: Any) -> None:
        if getattr(node, "ndim", 0) in (1, 2) and node.dtype.kind in KINDS:
            found[name] = node
        seen.append(name)
        check_count("data sets", len(seen))

    if hasattr(observed, "visititems"):
        observed.visititems(visit)
    elif observed is not None:
        visit(MINARI.observed, observed)
    return found


def _needed(
    root: Any, label: str, observed: str, first: dict[str, Any], keys: Sequence[str]
) -> dict[str, Any]:
    """The data sets of a demonstration that are read, in one shape and of one length."""
    datasets: dict[str, Any] = {}
    for key in keys:
        path = f"{label}/{observed}" if key == observed else f"{label}/{observed}/{key}"
        data = _member(root, path)
        same = getattr(getattr(data, "dtype", None), "kind", "") in KINDS
        if not same or data.shape[1:] != first[key].shape[1:] or data.ndim != first[key].ndim:
            raise DemonstrationError(
                f"{label} must hold {key} in the shape of the first demonstration"
            )
        datasets[key] = data
        if len(data) != (samples := len(datasets[keys[0]])):
            raise DemonstrationError(
                f"{label}, {key} must have {samples} samples like {keys[0]}, got {len(data)}"
            )
    return datasets


def _member(group: Any, path: str) -> Any:
    """The content of a group under a path, or None.

    Raises DemonstrationError at a link, which may lead to another file.
    """
    h5py = optional("h5py")
    for part in filter(None, path.split("/")):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise DemonstrationError(f"{part} must lie in the file itself, got a link")
        group = group[part]
    return group


def _check_storage(datasets: Sequence[Any]) -> None:
    """Check the numbers before one is read.

    Raises DemonstrationError if some are in other files, unpack to more than their stated size, are
    packed in an unknown way, or are too many.
    """
    for data in datasets:
        if data.is_virtual or data.external:
            raise DemonstrationError(
                f"{data.name} must hold its numbers itself, got some of other files"
            )
    check_count("numbers", sum(max(data.size, math.prod(data.chunks or ())) for data in datasets))
    chunked = [data for data in datasets if data.chunks]
    check_count("chunks", sum(map(_chunk_count, chunked)))
    for data in chunked:
        _check_packed(data)


def _chunk_count(data: Any) -> int:
    return math.prod(-(-n // size) for n, size in zip(data.shape, data.chunks, strict=True))


def _check_packed(data: Any) -> None:
    """Unpack chunks one by one, up to the limit."""
    properties = data.id.get_create_plist()
    filters = [properties.get_filter(index)[0] for index in range(properties.get_nfilters())]
    if len(set(filters)) != len(filters) or set(filters) - FILTERS or {GZIP, LZF} <= set(filters):
        raise DemonstrationError(
            f"{data.name} must be packed by gzip or lzf or not at all, got filters {filters}"
        )
    stored: list[Any] = []
    if filters:
        data.id.chunk_iter(stored.append)
    most = math.prod(data.chunks) * data.dtype.itemsize
    for chunk in stored:
        if GZIP in filters and not chunk.filter_mask >> filters.index(GZIP) & 1:
            packed = data.id.read_direct_chunk(chunk.chunk_offset)[1]
            # a checksum has four bytes
            larger = len(zlib.decompressobj().decompress(packed, most + 5)) > most + 4
        else:
            larger = LZF in filters and chunk.size > LZF_BYTES
        if larger:
            raise DemonstrationError(f"{data.name} has a chunk of more than {most} bytes")
