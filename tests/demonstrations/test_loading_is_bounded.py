"""Small files that claim much, point elsewhere or unpack without end are refused in a line."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.bounded import MIB, measured
from tests.helpers.data_sets import write_npz
from tests.helpers.hostile import members_of
from tests.helpers.refusal import refused
from torch_pmil.demonstrations import DemonstrationError, load_recordings

MEGABYTES, SMALL = 300, 32 * MIB  # of growth; bytes of a file


def refusal_of(path: Path, **options: object) -> str:
    """The line with which a small file is refused, in seconds and in little memory."""
    assert path.stat().st_size < SMALL
    loads = measured([lambda: load_recordings(path, **options)], DemonstrationError)
    assert len(loads) == 1 and not loads[0].failure, loads[-1].failure
    assert loads[0].megabytes < MEGABYTES and loads[0].refusal
    return loads[0].refusal.removeprefix(f"{path}: ")


def npy(kind: str, shape: str) -> bytes:
    """An array in NumPy's format that has no bytes."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
    return np.lib.format.magic(1, 0) + struct.pack("<H", 118) + header.ljust(117).encode() + b"\n"


@pytest.mark.parametrize("name", ["positions", "names", "targets", "target_names"])
@pytest.mark.parametrize("kind", ["<f8", "<U0", "|V0", "|u1"])
def test_array_is_no_larger_than_its_bytes(tmp_path: Path, name: str, kind: str) -> None:
    path = write_npz(tmp_path)
    members = {**members_of(path), f"{name}.npy": npy(kind, "(300000000,)")}
    with zipfile.ZipFile(path, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    assert refusal_of(path) == "there must be at most 16777216 numbers, got 300000000"


def test_names_are_counted_before_they_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "walks.npz"
    names = np.full(5_000_000, "abc")
    np.savez_compressed(path, positions=np.zeros((2, 3, 1)), time_step=0.1, names=names)
    assert refusal_of(path) == "there must be at most 10000 entries, got 5000000"


@pytest.mark.parametrize(
    ("row", "cells"),
    [(b"\n", 5_000_003), (b"1,1,1\n", 15_000_003), (b"10,", 5_000_003), (b"\r", 5_000_002)],
    ids=str,
)
def test_cells_are_counted_before_they_are_read(tmp_path: Path, row: bytes, cells: int) -> None:
    path = tmp_path / "walks.csv"
    path.write_bytes(b"demonstration,time,x\n" + row * 5_000_000)
    assert refusal_of(path) == f"there must be at most 2097152 cells, got {cells}"


def test_demonstrations_are_counted(tmp_path: Path) -> None:
    rows = "".join(f"{number},0,0\n" for number in range(10_001))
    (tmp_path / "walks.csv").write_text(f"demonstration,time,x\n{rows}")
    assert refusal_of(tmp_path / "walks.csv").endswith("at most 10000 demonstrations, got 10001")


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<2I", kind, len(content)) + content + bytes(-len(content) % 8)


def matlab_array(kind: int, shape: tuple[int, ...], name: bytes, content: bytes) -> bytes:
    flags = element(6, struct.pack("<2I", kind, 0))
    dims = element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, flags + dims + element(1, name) + content)


NO_FIELDS = element(5, struct.pack("<i", 32)) + element(1, b"")


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    ("kind", "content"),
    [(1, b""), (2, NO_FIELDS), (4, element(1, b"")), (6, element(9, b""))],
    ids=["cells", "structures", "letters", "numbers"],
)
def test_matlab_array_is_no_larger_than_its_bytes(
    tmp_path: Path, kind: int, content: bytes, packed: bool
) -> None:
    inner = matlab_array(kind, (1, 10**9), b"", content)
    outer = matlab_array(1, (1, 1), b"demos", inner)
    body = element(15, zlib.compress(outer)) if packed else outer
    (tmp_path / "shape.mat").write_bytes(b"MATLAB".ljust(124) + b"\x00\x01IM" + body)
    assert refusal_of(tmp_path / "shape.mat").endswith("cannot have the shape (1, 1000000000)")


def h5py() -> Any:
    return pytest.importorskip("h5py")


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """Numbers that are nobody's business."""
    with h5py().File(tmp_path / "secret.h5", "w") as file:
        file["demo/obs/x"] = np.arange(5.0)
    return tmp_path / "secret.h5"


def demonstrations(folder: Path, write: Callable[[Any, str], object]) -> Path:
    """A file of two demonstrations, each written by a function of file and group."""
    with h5py().File(folder / "demo.hdf5", "w") as file:
        for number in range(2):
            write(file, f"data/demo_{number}")
    return folder / "demo.hdf5"


def data_set(folder: Path, shape: tuple[int, ...] | None = None, **options: object) -> Path:
    """Of such demonstrations, each with one data set of a shape or of given numbers."""
    return demonstrations(
        folder, lambda file, demo: file.create_dataset(f"{demo}/obs/x", shape, "f8", **options)
    )


@pytest.mark.parametrize(
    ("place", "target"), [("", "/demo"), ("/obs", "/demo/obs"), ("/obs/x", "/demo/obs/x")]
)
@pytest.mark.parametrize("soft", [False, True])
def test_links_of_hdf5_are_not_followed(
    tmp_path: Path, secret: Path, place: str, target: str, soft: bool
) -> None:
    def write(file: Any, demo: str) -> None:
        if demo.endswith("0"):
            file[f"{demo}/obs/x"] = np.zeros(5)
        elif soft:
            file["away"] = h5py().ExternalLink(str(secret), target)
            file[demo + place] = h5py().SoftLink("/away")
        else:
            file[demo + place] = h5py().ExternalLink(str(secret), target)

    path = demonstrations(tmp_path, write)
    name = (place or "demo_1").rpartition("/")[2]
    expected = f"{path}: {name} must lie in the file itself, got a link"
    assert refused(load_recordings, path, time_step=0.1) == expected


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_numbers_of_other_files_are_not_read(tmp_path: Path, secret: Path, kind: str) -> None:
    def write(file: Any, demo: str) -> None:
        if kind == "external":
            file.create_dataset(f"{demo}/obs/x", (5,), "f8", external=[(str(secret), 0, 40)])
            return
        layout = h5py().VirtualLayout((5,), "f8")
        layout[:] = h5py().VirtualSource(str(secret), "demo/obs/x", (5,))
        file.create_virtual_dataset(f"{demo}/obs/x", layout)

    path = demonstrations(tmp_path, write)
    assert refusal_of(path, time_step=0.1).startswith(
        "/data/demo_0/obs/x must hold its numbers itself, got some of other files"
    )


@pytest.mark.parametrize(
    ("shape", "chunk", "complaint"),
    [
        ((5,), 2**28, "at most 16777216 numbers, got 536870912"),
        ((8_000_000,), 1, "at most 131072 chunks, got 16000000"),
    ],
)
def test_chunks_are_counted(tmp_path: Path, shape: tuple[int], chunk: int, complaint: str) -> None:
    path = data_set(tmp_path, shape, chunks=(chunk,), maxshape=(None,))
    assert refusal_of(path, time_step=0.1) == f"there must be {complaint}"


def test_chunk_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    packing = zlib.compressobj(1)
    packed = b"".join(packing.compress(bytes(16 * MIB)) for _ in range(64)) + packing.flush()

    def write(file: Any, demo: str) -> None:
        data = file.create_dataset(f"{demo}/obs/x", (5,), "f8", chunks=(5,), compression="gzip")
        data.id.write_direct_chunk((0,), packed)

    path = demonstrations(tmp_path, write)
    assert refusal_of(path, time_step=0.1) == "/data/demo_0/obs/x has a chunk of more than 40 bytes"


@pytest.mark.parametrize("options", [{"compression": "lzf"}, {"compression": "gzip"}, {}], ids=str)
@pytest.mark.parametrize("more", [{"shuffle": True}, {"fletcher32": True}, {}], ids=str)
def test_packed_chunks_come_back(tmp_path: Path, options: dict, more: dict) -> None:
    walk = np.random.default_rng(0).normal(size=(50, 2))
    path = data_set(tmp_path, data=walk, chunks=(7, 2), **options, **more)
    assert np.array_equal(load_recordings(path, time_step=0.1).values[1], walk)


def test_wide_data_set_is_refused_before_its_entries_are_named(tmp_path: Path) -> None:
    path = data_set(tmp_path, (2, 10**12), chunks=(1, 1))
    complaint = "there must be at most 10000 entries, got 1000000000000"
    assert refusal_of(path, time_step=0.1) == complaint


@pytest.mark.parametrize("frequency", [10**400, 0, "x", [], None], ids=lambda value: str(value)[:9])
def test_control_frequency_that_is_none_is_refused(tmp_path: Path, frequency: object) -> None:
    path = data_set(tmp_path, data=np.zeros(3))
    with h5py().File(path, "a") as file:
        settings = {"env_kwargs": {"control_freq": frequency}}
        file["data"].attrs["env_args"] = json.dumps(settings)
    assert "time" in refusal_of(path)


EMPTY = [[], [], []]


@pytest.mark.parametrize(
    ("episodes", "states", "complaint"),
    [
        (np.arange(200_000), np.zeros(200_000), "at most 10000 demonstrations, got 200000"),
        (["x"] * 3, np.zeros(3), "column episode_index must hold numbers, got string"),
        ([[0.0]] * 3, np.zeros(3), "column episode_index must hold numbers, got list"),
        (np.zeros(3), EMPTY, "must hold entries, got none"),
    ],
    ids=["many", "text", "lists", "no entries"],
)
def test_frames_of_parquet_are_counted_and_their_index_is_numbers(
    tmp_path: Path, episodes: Any, states: Any, complaint: str
) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    states = pa.array([[]] * 3, pa.list_(pa.float32())) if states is EMPTY else states
    columns = {"episode_index": episodes, "timestamp": np.arange(float(len(episodes)))}
    columns["observation.state"] = states
    pq.write_table(pa.table(columns), tmp_path / "walks.parquet")
    assert complaint in refusal_of(tmp_path / "walks.parquet")


def test_line_is_short_whatever_a_file_puts_into_it(tmp_path: Path) -> None:
    header = "x" * 100_000 + "\x1b[31m"
    (tmp_path / "walks.csv").write_text(f"demonstration,{header}\n")
    line = refusal_of(tmp_path / "walks.csv")
    assert len(line) <= 1000 and line.isprintable()
