"""CSV: a folder is the same as a file; columns are chosen; errors name file, row and column."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_demonstrations, load_recordings

SAMPLES = {
    "demo_9": [(0.0, 1.0, -1.0), (0.1, 2.0, -2.0)],
    "demo_10": [(0.0, 3.0, -3.0), (0.15, 4.0, -4.0), (0.2, 5.0, -5.0)],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "walks").mkdir()
    for label, rows in SAMPLES.items():
        lines = ["time,x,y", *(",".join(map(str, row)) for row in rows)]
        (tmp_path / "walks" / f"{label}.csv").write_text("\n".join(lines))
    (tmp_path / "walks" / "README.txt").write_text("not a demonstration")
    return tmp_path / "walks"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    rows = [f"{label},{time},{x},{y}" for label, rows in SAMPLES.items() for time, x, y in rows]
    (tmp_path / "walks.csv").write_text("\n".join(["demonstration,time,x,y", *rows]))
    return tmp_path / "walks.csv"


def test_folder_holds_what_one_file_would_in_the_order_of_the_numbers_in_names(
    folder: Path, file: Path
) -> None:
    apart, together = load_recordings(folder), load_recordings(file)
    assert apart.labels == together.labels == ("demo_9", "demo_10")
    assert apart.names == together.names == ("x", "y")
    assert apart.format == together.format == "CSV"
    for part in ("times", "values"):
        assert all(map(torch.equal, getattr(apart, part), getattr(together, part)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("time,x,z\n0,1,2", "row 1 must be time,x,y as in the files before it, got time,x,z"),
        ("x,y\n1,2", "row 1 must be time,NAME,..., got x,y"),
        ("time,x,y\n0,1,2\n0.1,1,far", "row 3, column y must be a finite number, got 'far'"),
        ("time,x,y\n0,1,2\n0,1,2", "row 3, time must increase, got 0 s after 0 s"),
    ],
)
def test_malformed_file_of_a_folder_is_named(folder: Path, change: str, message: str) -> None:
    (folder / "demo_10.csv").write_text(change)
    assert refused(load_recordings, folder) == f"{folder}: demo_10.csv: {message}"


def test_columns_are_read_in_the_order_of_keys_and_renamed(file: Path) -> None:
    recordings = load_recordings(file, keys=["y", "x"], names=["up", "along"])
    assert recordings.names == ("up", "along")
    assert torch.equal(recordings.values[0], load_recordings(file).values[0][:, [1, 0]])


def test_column_that_is_not_asked_for_may_hold_anything(file: Path) -> None:
    whole = load_recordings(file, keys=["x"])
    file.write_text(file.read_text().replace(",-4.0", ",lost"))
    assert torch.equal(load_recordings(file, keys=["x"]).values[1], whole.values[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keys": ["x", "z"]}, "keys must be some of x, y, got z"),
        ({"names": ["a"]}, "names must be 2 different names, one per column, got ('a',)"),
        ({"time_step": 0.1}, "time_step must be left out: the file has times of its own, got 0.1"),
    ],
)
def test_option_that_does_not_fit_is_one_line(
    file: Path, options: dict[str, object], message: str
) -> None:
    assert refused(load_recordings, file, **options) == f"{file}: {message}"


def test_folder_of_one_length_and_step_loads_as_demonstrations(
    folder: Path, tmp_path: Path
) -> None:
    complaint = "demonstration demo_10 must have 2 samples like demonstration demo_9, got 3"
    assert complaint in refused(load_demonstrations, folder)
    (folder / "demo_10.csv").write_text("time,x,y\n5.0,3,-3\n5.1,4,-4")
    shown = load_demonstrations(folder, 0.1, names=("a", "b"))
    assert shown.names == ("a", "b")
    assert shown.positions.tolist() == [[[1, -1], [2, -2]], [[3, -3], [4, -4]]]
    saved = tmp_path / "walks.npz"  # of which entries are chosen and renamed likewise
    shown.save(saved)
    chosen = load_demonstrations(saved, keys=["b"], names=["height"])
    assert chosen.names == ("height",) and torch.equal(chosen.positions, shown.positions[..., 1:])
    complaint = f"{saved}: keys must be some of a, b, got z"
    assert refused(load_demonstrations, saved, keys=["z"]) == complaint
    recordings = load_recordings(saved, keys=["b"])
    assert torch.equal(torch.stack(recordings.values), shown.positions[..., 1:])
    assert recordings.format == "NPZ"


def test_folder_of_no_format_is_refused(tmp_path: Path) -> None:
    message = (
        "a folder of demonstrations must hold one of meta/info.json, data/metadata.json, "
        "metadata.json, *.csv, *.mat, got none"
    )
    assert refused(load_recordings, tmp_path) == f"{tmp_path}: {message}"
