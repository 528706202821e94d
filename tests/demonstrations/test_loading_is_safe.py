"""Loading executes nothing that a file carries, and says which library is missing."""

from __future__ import annotations

import os
import pickle
import struct
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_demonstrations, load_recordings


class Malicious:
    """Makes a file where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.mark,)


@pytest.fixture
def mark(tmp_path: Path) -> Path:
    return tmp_path / "executed"


@pytest.fixture
def payload(mark: Path) -> bytes:
    payload = pickle.dumps(Malicious(mark))
    pickle.loads(payload)
    assert mark.exists()
    mark.unlink()
    return payload


each_load = pytest.mark.parametrize("load", [load_recordings, load_demonstrations])


@pytest.fixture(params=["npz", "csv", "mat", "hdf5", "h5", "parquet"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Of a file in each format."""
    if request.param in ("hdf5", "h5", "parquet"):
        pytest.importorskip({"parquet": "pyarrow"}.get(request.param, "h5py"))
    return tmp_path / f"walks.{request.param}"


@each_load
def test_pickle_under_any_suffix_is_refused_and_not_executed(
    path: Path, mark: Path, payload: bytes, load: object
) -> None:
    path.write_bytes(payload)
    assert refused(load, path).startswith(f"{path}: not a readable ")
    assert not mark.exists()


@pytest.mark.parametrize("name", ["positions", "names", "time_step", "targets"])
def test_pickle_inside_an_npz_is_refused_and_not_executed(
    tmp_path: Path, mark: Path, payload: bytes, name: str
) -> None:
    held = np.empty((), dtype=object)
    held[()] = Malicious(mark)
    arrays = {"positions": np.zeros((2, 3, 1)), "time_step": 0.1, "names": np.array(["x"])}
    np.savez(tmp_path / "walks.npz", **{**arrays, name: held})
    for load in (load_recordings, load_demonstrations):
        complaint = refused(load, tmp_path / "walks.npz")
        assert "not a readable NPZ file without object arrays" in complaint
    assert not mark.exists()


def test_pickle_inside_a_matlab_file_stays_bytes(
    tmp_path: Path, mark: Path, payload: bytes
) -> None:
    demo = {"pos": np.frombuffer(payload, np.uint8), "t": np.arange(3.0)[None]}
    savemat(tmp_path / "shape.mat", {"demos": np.array([[demo, demo]], dtype=object)})
    refused(load_recordings, tmp_path / "shape.mat")
    assert not mark.exists()


def test_pickle_inside_hdf5_stays_bytes(tmp_path: Path, mark: Path, payload: bytes) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        for number in range(2):
            file[f"data/demo_{number}/obs/x"] = np.void(payload)
        file["data"].attrs["env_args"] = np.void(payload)
    refused(load_recordings, tmp_path / "demo.hdf5", keys=["x"])
    refused(load_recordings, tmp_path / "demo.hdf5", keys=["x"], time_step=0.1)
    assert not mark.exists()


def test_pickle_inside_parquet_stays_bytes(tmp_path: Path, mark: Path, payload: bytes) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    metadata = {
        b"ARROW:extension:name": b"arrow.py_extension_type",
        b"ARROW:extension:metadata": payload,
    }
    columns = {"episode_index": pa.array([0, 1]), "timestamp": pa.array([0.0, 0.0])}
    columns["observation.state"] = pa.array([payload, payload])
    fields = [pa.field(name, column.type, metadata=metadata) for name, column in columns.items()]
    schema = pa.schema(fields, metadata={b"pandas": payload})
    pq.write_table(pa.table(columns, schema=schema), tmp_path / "walks.parquet")
    refused(load_recordings, tmp_path / "walks.parquet")
    assert not mark.exists()


@pytest.mark.parametrize(("suffix", "library"), [("hdf5", "h5py"), ("parquet", "pyarrow")])
def test_missing_library_is_one_line_that_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, library: str
) -> None:
    (tmp_path / f"walks.{suffix}").touch()
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError) as error:
        load_recordings(tmp_path / f"walks.{suffix}")
    line = f"reading this format needs {library}: pip install 'torch_pmil[formats]'"
    assert str(error.value) == line


@each_load
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_is_no_file_is_refused_at_once(path: Path, kind: str, load: object) -> None:
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    assert refused(load, path).startswith(f"{path}: must be a regular file of at most ")
    assert refused(load, path).endswith(f", got a {kind}")


def test_pipe_in_a_folder_of_demonstrations_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "1.csv")
    assert "1.csv: must be a regular file" in refused(load_recordings, tmp_path)


@pytest.mark.parametrize("suffix", ["npz", "csv", "mat"])
def test_huge_file_is_refused_before_it_is_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"walks.{suffix}"
    with path.open("wb") as file:
        file.truncate(2**40)
    assert refused(load_recordings, path).endswith("MiB, got 1048576 MiB")


def test_npz_that_unpacks_without_end_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "walks.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for number in range(3):
            archive.writestr(f"{number}.npy", bytes(90 * 2**20))
    complaint = refused(load_recordings, path)
    assert "members must have at most 256 MiB together, got 270 MiB" in complaint


def test_matlab_file_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    packed = zlib.compress(bytes(70 * 2**20), 1)
    header = b"MATLAB".ljust(124) + b"\x00\x01IM"
    path = tmp_path / "shape.mat"
    path.write_bytes(header + struct.pack("<2I", 15, len(packed)) + packed)
    complaint = "there must be at most 67108864 unpacked bytes, got 68157440"
    assert complaint in refused(load_recordings, path)


def test_hdf5_that_says_it_is_endless_is_refused_before_it_is_read(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "demo.hdf5", "w") as file:
        for number in range(2):
            file.create_dataset(f"data/demo_{number}/obs/x", (10**9, 3), "f8", chunks=(100, 3))
    assert (tmp_path / "demo.hdf5").stat().st_size < 10**6
    complaint = refused(load_recordings, tmp_path / "demo.hdf5", time_step=0.1)
    assert complaint.endswith("there must be at most 16777216 numbers, got 6000000000")


def test_parquet_that_says_it_is_endless_is_refused_before_it_is_read(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rows = 6_000_000
    columns = {"episode_index": np.zeros(rows, int), "timestamp": np.zeros(rows)}
    columns["observation.state"] = np.zeros(rows)
    pq.write_table(pa.table(columns), tmp_path / "walks.parquet")
    assert (tmp_path / "walks.parquet").stat().st_size < 10**6
    complaint = refused(load_recordings, tmp_path / "walks.parquet")
    assert "at most 16777216 numbers, got 18000000" in complaint
