"""CSV: a folder is the same as a file; columns are chosen; errors name file, row and column."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_demonstrations, load_recordings
from torch_pmil.demonstrations.errors import TIME_STEP

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
        (
            "time,x,z\n0,1,2",
            "row 1 must have the columns of the files before it, unless keys choose some, but y is "
            "only in those",
        ),
        ("time,y,x,x\n0,1,2,3", "row 1 must hold a column x once, got 2 of them"),
        ("x,y\n1,2", "row 1 must be time,NAME,..., got x,y"),
        (
            "time,x,y\n0,1,2\n0.1,1,far",
            "row 3, column y must be a finite number, or left out by keys, got 'far'",
        ),
        ("time,x,y\n0,1,2\n0,1,2", "row 3, time must increase, got 0.0 s after 0.0 s"),
        ("time,x,y\n", "must hold samples, got a header alone"),
    ],
)
def test_malformed_file_of_a_folder_is_named(folder: Path, change: str, message: str) -> None:
    (folder / "demo_10.csv").write_text(change)
    assert refused(load_recordings, folder) == f"{folder}: demo_10.csv: {message}"


def test_suffix_may_be_in_capitals(folder: Path, file: Path) -> None:
    before = load_recordings(folder)
    (folder / "demo_10.csv").rename(folder / "demo_10.CSV")
    after = [load_recordings(folder), load_recordings(file.rename(file.with_suffix(".CSV")))]
    for path in sorted(folder.iterdir()):
        path.rename(path.with_suffix(path.suffix.upper()))
    for read in [*after, load_recordings(folder)]:
        assert read.labels == before.labels
        assert all(map(torch.equal, read.values, before.values))
    (folder / "demo_10.csv").write_text("time,x,y\n9,1,2")
    message = "its name must differ from those of the files before it, got demo_10 again"
    assert refused(load_recordings, folder).endswith(message)


def test_labels_that_are_numbers_are_compared_as_numbers(tmp_path: Path) -> None:
    labels = ["0", "1", "0.0", "01", "a", "a.0", str(10**20), str(10**20 + 1)]
    rows = [f"{label},{time},1" for time, label in enumerate(labels)]
    (tmp_path / "walks.csv").write_text("\n".join(["demonstration,time,x", *rows]))
    read = load_recordings(tmp_path / "walks.csv")
    assert read.labels == ("0", "1", *labels[4:])
    assert [one.tolist() for one in read.times[:2]] == [[0, 2], [1, 3]]


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
        (
            {"time_step": 0.1},
            f"{TIME_STEP} must be left out: the file has times of its own, got 0.1",
        ),
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


PLAIN = "demonstration,time,x,y\n1,0,1,2\n1,0.5,3,4\n2,0,5,6\n2,0.5,7,8\n"
NOTES = PLAIN.replace("y\n", "y,note,note,\n", 1).replace("5,3,4", "5,3,4,slow,nan,")
WRITTEN = {
    "byte order mark": "\ufeff" + PLAIN,
    "line ends of Windows": PLAIN.replace("\n", "\r\n"),
    "semicolons": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "spaces": PLAIN.replace(",", " , "),
    "quotes after spaces": PLAIN.replace("demonstration,time,x", '"demonstration", "time", "x"'),
    "blank lines": PLAIN.replace("\n", "\n\n  \n,,,\n"),
    "empty last column": PLAIN.replace("\n", ",\n"),
    "empty cells after the rows": PLAIN.replace("4\n", "4,,\n"),
    "empty names after the header": PLAIN.replace("y\n", "y,,\n", 1),
    "milliseconds": PLAIN.replace("time", "Time [ms]").replace("0.5", "500"),
    "nanoseconds": PLAIN.replace("time", "timestamp_ns").replace("0.5", "500000000"),
    "microseconds": PLAIN.replace("time", "t (µs)").replace("0.5", "500000"),
    "seconds": PLAIN.replace("time", "time_s"),
    "another name of the time": PLAIN.replace("time", "timestamp"),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_tables_of_other_programs_hold_the_same_numbers(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "walks.csv"
    path.write_text(WRITTEN[kind], encoding="utf-8", newline="")
    read = load_recordings(path)
    assert (read.labels, read.names) == (("1", "2"), ("x", "y"))
    assert [one.tolist() for one in read.times] == [[0.0, 0.5]] * 2
    assert [one.tolist() for one in read.values] == [[[1, 2], [3, 4]], [[5, 6], [7, 8]]]
    assert read.in_seconds == (kind.endswith("seconds"))


@pytest.mark.parametrize(
    "header",
    ["note,y,time,note,demonstration,x", "demonstration,time,,x,y", "demonstration,x,y,time,"],
)
def test_columns_that_keys_leave_out_may_be_named_and_hold_anything(
    tmp_path: Path, header: str
) -> None:
    cells = {"demonstration": "ab", "time": "00", "x": "13", "y": "24"}
    rows = [",".join(cells.get(name, "??")[row] for name in header.split(",")) for row in (0, 1)]
    (tmp_path / "walks.csv").write_text("\n".join([header, *rows]))
    read = load_recordings(tmp_path / "walks.csv", keys=["y", "x"])
    assert [one.tolist() for one in read.values] == [[[2, 1]], [[4, 3]]]


def test_files_of_a_folder_may_differ_in_columns_that_keys_leave_out(folder: Path) -> None:
    before = load_recordings(folder, keys=["y"])
    content = (folder / "demo_9.csv").read_text().replace("time,x,y", "time,z,y")
    (folder / "demo_9.csv").write_text(content.replace(",1.0,", ",lost,"))
    after = load_recordings(folder, keys=["y"])
    assert all(map(torch.equal, before.values, after.values))
    turned = [",".join(reversed(line.split(","))) for line in content.splitlines()]
    (folder / "demo_9.csv").write_text("\n".join(turned))
    assert all(map(torch.equal, before.values, load_recordings(folder, keys=["y"]).values))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (PLAIN.replace("y", "", 1), "names must have 1 to 200 printable characters, got ''"),
        (
            PLAIN.replace("y", "y" * 10**5, 1),
            f"names must have 1 to 200 printable characters, got '{'y' * 56}...{'y' * 59}'"[:70],
        ),
        (PLAIN.replace("\n2,", "\n,"), "row 4, column demonstration must hold a name, got none"),
        (PLAIN.replace("time", "frame"), "row 1 must be demonstration,time,NAME,..., got demon"),
        (PLAIN.replace("time,x", "time_ms,time_s"), "row 1 must be demonstration,time,NAME,..., "),
        (PLAIN.replace("0.5,3", '"0,5",3'), "row 3, column time must be a finite number, got '0,5"),
        (
            PLAIN.replace(",", ";").replace("0.5;3", "0,5;3"),
            "row 3, column time must be a finite number, got '0,5'; write a decimal point",
        ),
        (
            PLAIN.replace("3,4", "1_5,4"),
            "row 3, column x must be a finite number, or left out by keys, got '1_5'",
        ),
        (PLAIN.replace("0.5", "1694012345.25").replace(",0,", ",1694012345.5,"), "row 3, time must "
         "increase, got 1694012345.25 s after 1694012345.5 s"),
        (
            "demonstration,time," + ",".join(f"c{n}" for n in range(123)) + ",c7\n1" + 125 * ",1",
            "row 1 must hold a column c7 once, got 2 of them",
        ),
    ],
)  # fmt: skip
def test_refusal_says_what_is_there(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "walks.csv").write_text(content)
    complaint = refused(load_recordings, tmp_path / "walks.csv")
    assert complaint.startswith(f"{tmp_path / 'walks.csv'}: {message}")
