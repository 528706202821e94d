"""A file of another kind than its suffix says is named; numbers of every kind are read."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.data_sets import WALKS
from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_recordings

KINDS = {
    "csv": "a CSV",
    "npz": "an NPZ",
    "mat": "a MATLAB",
    "h5": "an HDF5",
    "parquet": "a Parquet",
}
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab\nsize 12345\n"


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "an empty file"),
        (b" \n", "an empty file"),
        (POINTER, "a Git LFS pointer: git lfs pull fetches the file it stands for"),
        (b"\n<!DOCTYPE html><html></html>", "a web page"),
        (gzip.compress(b"demonstration,time,x", mtime=0), "a gzip archive"),
        ("demonstration,time,x".encode("utf-16"), "text in UTF-16, not UTF-8"),
        (b"\x93NUMPY\x01\x00", "a single array of NumPy"),
    ],
)
def test_other_file_is_named(tmp_path: Path, suffix: str, content: bytes, found: str) -> None:
    pytest.importorskip({"parquet": "pyarrow", "h5": "h5py"}.get(suffix, "numpy"))
    path = tmp_path / f"walks.{suffix}"
    path.write_bytes(content)
    assert refused(load_recordings, path) == f"{path}: must be {KINDS[suffix]} file, got {found}"


@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", ">f4", "f2", "g", "<i4", ">i4", "u1"])
def test_numbers_of_any_precision_and_byte_order_are_read(tmp_path: Path, kind: str) -> None:
    numbers = np.arange(24).reshape(2, 4, 3)
    arrays = {"positions": numbers.astype(kind), "names": np.array(["x", "y", "z"])}
    targets = {"targets": np.array([[7], [7]]).astype(kind), "target_names": np.array(["place"])}
    np.savez(tmp_path / "walks.npz", **arrays, **targets, time_step=np.array(2).astype(kind))
    read = load_recordings(tmp_path / "walks.npz")
    assert [one.tolist() for one in read.values] == numbers.tolist()
    assert read.times[0].tolist() == [0.0, 2.0, 4.0, 6.0]
    assert read.targets is not None and read.targets.tolist() == [[7.0], [7.0]]


@pytest.mark.parametrize(
    "names", [[b"x", b"y"], [1, 2], ["x", ""], ["x", "y" * 10**6], ["x", "\n"]]
)
def test_names_of_entries_are_short_text(tmp_path: Path, names: list[object]) -> None:
    np.savez(tmp_path / "walks.npz", positions=WALKS, time_step=0.1, names=np.array(names))
    complaint = refused(load_recordings, tmp_path / "walks.npz")
    if isinstance(names[1], str):
        assert "names must have 1 to 200 printable characters, got " in complaint
    else:
        assert complaint.endswith("array time_step must be one number and names a list of text")
