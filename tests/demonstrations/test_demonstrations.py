"""Demonstrations: what is refused, and that files hold what was saved."""

import os

import numpy as np
import pytest
import torch

from reproduction.teachers.reaching import TRAINING_TARGETS
from torch_pmil.demonstrations import (
    DemonstrationError,
    Demonstrations,
    load_demonstrations,
    load_recordings,
    shipped_demonstrations,
)


def walk(*shape):
    return torch.randn(
        *shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    ).cumsum(dim=1)


def with_value(positions, index, value):
    positions[index] = value
    return positions


def refused(function, *arguments):
    with pytest.raises(DemonstrationError) as error:
        function(*arguments)
    assert "\n" not in str(error.value)
    return str(error.value)


def write_npz(path, **changes):
    arrays = {"positions": walk(3, 5, 2).numpy(), "time_step": 0.1, "names": np.array(["x", "y"])}
    arrays = {name: value for name, value in {**arrays, **changes}.items() if value is not None}
    np.savez(path, **arrays)
    return path


def csv_lines():
    rows = [f"{label},{0.1 * step},{step},{label * step}" for label in (1, 2) for step in range(4)]
    return ["demonstration,time,x,y", *rows]


def write_csv(path, lines):
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("positions", "time_step", "names", "message"),
    [
        (
            walk(3, 5),
            0.1,
            ("x",),
            "positions must have shape (demonstrations, steps, columns), got (3, 5)",
        ),
        (walk(2, 5, 2), 0.1, ("x",), "names must be 2 different names, one per column, got ('x',)"),
        (
            with_value(walk(2, 5, 2), (1, 3, 1), torch.nan),
            0.1,
            ("x", "y"),
            "positions must be finite, got nan in demonstration 1, step 3, column y",
        ),
    ],
)
def test_malformed_demonstrations_are_refused(positions, time_step, names, message):
    assert refused(Demonstrations, positions, time_step, names) == message


def test_interrupted_save_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "walks.npz"
    Demonstrations(walk(2, 5, 1), 0.1, ("x",)).save(path)
    before = path.read_bytes()

    def interrupted(file, **arrays):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Demonstrations(walk(3, 5, 1), 0.1, ("x",)).save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["walks.npz"]


def test_missing_file_is_an_os_error(tmp_path):
    for name in ("none.npz", "none.csv"):
        with pytest.raises(FileNotFoundError):
            load_demonstrations(tmp_path / name)


def test_other_kind_of_file_is_refused(tmp_path):
    path = tmp_path / "walks.txt"
    path.touch()
    expected = (
        f"{path}: demonstrations must be a .npz, .csv, .mat, .hdf5, .h5 or .parquet file, or a "
        "folder of them, got .txt"
    )
    assert refused(load_demonstrations, path) == refused(load_recordings, path) == expected


@pytest.mark.parametrize(
    "damage",
    [
        *(lambda file, content=content: content for content in (b"", b"no archive", b"PK\3\4 cut")),
        *(lambda file, cut=cut: file[:cut] for cut in (10, 200, 400, -30)),
        lambda file: file[:250] + bytes([file[250] ^ 0xFF]) + file[251:],
    ],
)
def test_damaged_npz_is_refused(tmp_path, damage):
    path = write_npz(tmp_path / "walks.npz")
    path.write_bytes(damage(path.read_bytes()))
    assert refused(load_demonstrations, path).startswith(f"{path}: not a readable NPZ file")


@pytest.mark.parametrize("name", ["positions", "time_step", "names"])
def test_missing_array_is_named(tmp_path, name):
    path = write_npz(tmp_path / "walks.npz", **{name: None})
    assert refused(load_demonstrations, path).startswith(
        f"{path}: array {name} is missing, found ["
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"positions": np.full((2, 3, 1), "a")},
            "arrays positions and time_step must hold real numbers",
        ),
        ({"time_step": np.ones(2)}, "array time_step must be one number and names a list"),
        ({"positions": walk(1, 3, 2)}, "positions must hold at least two demonstrations, got 1"),
        (
            {"targets": np.array([["a"]] * 3), "target_names": np.array(["y"])},
            "array targets must hold real numbers and target_names be a list",
        ),
    ],
)
def test_malformed_arrays_are_refused_naming_the_file(tmp_path, changes, message):
    path = write_npz(tmp_path / "walks.npz", **changes)
    assert refused(load_demonstrations, path) == f"{path}: {message}"


def test_time_step_of_the_file_must_be_the_expected_one(tmp_path):
    path = write_npz(tmp_path / "walks.npz")
    assert load_demonstrations(path, time_step=0.1).time_step == 0.1
    assert (
        refused(load_demonstrations, path, 0.05) == f"{path}: time_step must be 0.05 s, got 0.1 s"
    )


def test_csv_holds_one_sample_per_row(tmp_path):
    demonstrations = load_demonstrations(write_csv(tmp_path / "walks.csv", csv_lines()))
    steps = torch.arange(4.0, dtype=torch.float64)
    expected = torch.stack([torch.stack([steps, label * steps], -1) for label in (1, 2)])
    assert torch.equal(demonstrations.positions, expected)
    assert demonstrations.names == ("x", "y")
    assert demonstrations.time_step == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [], "row 1 must be demonstration,time,NAME,..., got nothing"),
        (
            lambda lines: ["time,x,y", *lines[1:]],
            "row 1 must be demonstration,time,NAME,..., got time,x,y",
        ),
        (lambda lines: lines[:5], "at least two demonstrations are needed, got 1"),
        (
            lambda lines: lines[:-1],
            "demonstration 2 must have 4 samples like demonstration 1, got 3; pmil align makes "
            "them one length",
        ),
        (lambda lines: [*lines[:2], "1,0.1,5", *lines[3:]], "row 3 must have 4 columns, got 3"),
        (
            lambda lines: [*lines[:2], "1,0.1,five,0", *lines[3:]],
            "row 3, column x must be a finite number, got 'five'",
        ),
        (
            lambda lines: [*lines[:2], "1,0.1,5,nan", *lines[3:]],
            "row 3, column y must be a finite number, got 'nan'",
        ),
        (
            lambda lines: [*lines[:-1], "2,0.4,5,0"],
            "row 9, time must follow the sample before it by 0.1 s, got 0.2 s; pmil align makes "
            "steps one length",
        ),
        (
            lambda lines: [*lines[:2], "1,0.0,5,0", *lines[3:]],
            "row 3, time must increase, got 0 s after 0 s",
        ),
        (
            lambda lines: [line.replace("time,x,y", "time,x,x") for line in lines],
            "names must be 2 different names, one per column, got ('x', 'x')",
        ),
    ],
)
def test_malformed_csv_is_refused_naming_file_and_row(tmp_path, change, message):
    path = write_csv(tmp_path / "walks.csv", change(csv_lines()))
    assert refused(load_demonstrations, path) == f"{path}: {message}"


def reaching_lines():
    header, *rows = csv_lines()
    told = [f"{row},{label},0.5" for label in ("0", "2") for row in rows]
    told = [
        f"{'ab'[index // 8]}{row}" for index, row in enumerate(told)
    ]  # four demonstrations, two of each target
    return [f"{header},target place,target height", *told]


def test_csv_tells_what_each_demonstration_was_for(tmp_path):
    path = write_csv(tmp_path / "reaches.csv", reaching_lines())
    for loaded in (load_demonstrations(path), load_recordings(path)):
        assert (
            loaded.targets.tolist() == [[0, 0.5], [0, 0.5], [2, 0.5], [2, 0.5]]
            and loaded.targets.dtype == torch.float64
        )
        assert (loaded.names, loaded.target_names) == (("x", "y"), ("place", "height"))
    plain = load_demonstrations(write_csv(tmp_path / "walks.csv", csv_lines()))
    assert (
        torch.equal(load_demonstrations(path).positions, plain.positions.repeat(2, 1, 1))
        and plain.targets is None
    )


def test_columns_of_targets_may_stand_anywhere_after_the_time(tmp_path):
    lines = [line.split(",") for line in reaching_lines()]
    path = write_csv(
        tmp_path / "reaches.csv",
        [",".join([*line[:2], line[4], line[2], line[5], line[3]]) for line in lines],
    )
    moved, loaded = (
        load_demonstrations(path),
        load_demonstrations(write_csv(tmp_path / "same.csv", reaching_lines())),
    )
    assert torch.equal(moved.positions, loaded.positions) and torch.equal(
        moved.targets, loaded.targets
    )
    assert (moved.names, moved.target_names) == (loaded.names, loaded.target_names)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda lines: [*lines[:3], lines[3].replace(",0,0.5", ",0,0.7"), *lines[4:]],
            "row 4, column target height must be 0.5 as in row 2 of the same demonstration, got "
            "0.7",
        ),
        (
            lambda lines: [lines[0].replace("height", "place"), *lines[1:]],
            "target_names must be 2 different names, one per entry, got ('place', 'place')",
        ),
        (
            lambda lines: lines[:-4],
            "each target must have at least two demonstrations, got one of [2.0, 0.5]",
        ),
        (
            lambda lines: [line.replace("time,x,y", "time,target x,target y") for line in lines],
            "row 1 must be demonstration,time,NAME,..., got demonstration,time,target x,target "
            "y,target place,target height",
        ),
        (
            lambda lines: [lines[0], f"{lines[1]}?", *lines[2:]],
            "row 2, column target height must be a finite number, got '0.5?'",
        ),
    ],
)
def test_malformed_targets_of_a_csv_are_refused_naming_file_and_row(tmp_path, change, message):
    path = write_csv(tmp_path / "reaches.csv", change(reaching_lines()))
    assert refused(load_demonstrations, path) == f"{path}: {message}"


def test_csv_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "walks.csv"
    path.write_bytes(b"\xff\xfe\x00demonstration")
    assert refused(load_demonstrations, path).startswith(f"{path}: not a readable CSV file")


def test_recordings_have_lengths_and_times_of_their_own(tmp_path):
    lines = csv_lines()[:-1]
    lines[2] = "1,0.15,1,1"
    recordings = load_recordings(write_csv(tmp_path / "walks.csv", lines))
    assert (recordings.labels, recordings.names) == (("1", "2"), ("x", "y"))
    assert [times.tolist() for times in recordings.times] == [
        pytest.approx([0, 0.15, 0.2, 0.3]),
        pytest.approx([0, 0.1, 0.2]),
    ]
    assert [values.tolist() for values in recordings.values] == [
        [[0, 0], [1, 1], [2, 2], [3, 3]],
        [[0, 0], [1, 2], [2, 4]],
    ]


def test_shipped_demonstrations_swing_up_and_balance():
    demonstrations = shipped_demonstrations("double_pendulum")
    assert demonstrations.positions.shape == (5, 26, 4)
    assert demonstrations.names == ("x1", "y1", "x2", "y2")
    assert demonstrations.duration == pytest.approx(2.5)
    hanging, upright = (torch.tensor([0, sign * 0.5, 0, sign * 1.0]) for sign in (-1, 1))
    assert ((demonstrations.positions[:, 0] - hanging).norm(dim=-1) < 0.5).all()
    assert ((demonstrations.positions[:, 20:] - upright).norm(dim=-1) < 0.25).all()


def test_shipped_demonstrations_have_links_of_constant_length():
    inner, outer = shipped_demonstrations().positions.split(2, dim=-1)
    assert (inner.norm(dim=-1) - 0.5).abs().max() < 1e-12
    assert ((outer - inner).norm(dim=-1) - 0.5).abs().max() < 1e-12


def test_shipped_demonstrations_with_targets_hold_the_tip_at_each_target_and_stand_still():
    demonstrations = shipped_demonstrations("double_pendulum_targets")
    assert (demonstrations.names, demonstrations.target_names) == (
        ("x1", "y1", "x2", "y2"),
        ("x", "y"),
    )
    assert demonstrations.duration == pytest.approx(2.5)
    targets, sets = demonstrations.by_target()
    assert torch.equal(targets, TRAINING_TARGETS)
    for target, reaches in zip(targets, sets, strict=True):
        assert reaches.positions.shape == (3, 26, 4)
        assert ((reaches.positions[:, 20:, 2:] - target).norm(dim=-1) < 0.1).all()
        assert reaches.positions[:, 20:].diff(dim=1).abs().max() < 0.05


def test_unknown_shipped_demonstrations_are_refused():
    names = "acrobot biorob biorob_targets cart_pole double_pendulum double_pendulum_targets "
    shipped = [*names.split(), "gym_pendulum", "inverted_pendulum", "pendubot"]
    assert f"must be one of {shipped}, got triple" in refused(shipped_demonstrations, "triple")


def reaching(
    targets=((0.0, 1.0), (0.0, 1.0), (2.0, 3.0), (2.0, 3.0), (2.0, 3.0)), names=("y", "z")
):
    return Demonstrations(walk(5, 4, 2), 0.1, ("a", "b"), torch.tensor(targets), names)


def test_demonstrations_of_several_targets_are_told_apart():
    shown = reaching()
    targets, sets = shown.by_target()
    assert targets.tolist() == [[0.0, 1.0], [2.0, 3.0]] and targets.dtype == torch.float64
    assert [one.positions.shape[0] for one in sets] == [2, 3]
    assert torch.equal(torch.cat([one.positions for one in sets]), shown.positions)


@pytest.mark.parametrize("saved", [Demonstrations(walk(3, 5, 2), 0.1, ("x", "y")), reaching()])
def test_saved_demonstrations_load_unchanged(tmp_path, saved):
    saved.save(tmp_path / "d.npz")
    loaded = load_demonstrations(tmp_path / "d.npz")
    assert torch.equal(loaded.positions, saved.positions)
    assert (loaded.time_step, loaded.names) == (saved.time_step, saved.names)
    assert loaded.target_names == saved.target_names
    assert loaded.targets is saved.targets is None or torch.equal(loaded.targets, saved.targets)


@pytest.mark.parametrize(
    ("targets", "names", "message"),
    [
        (
            torch.zeros(4, 2),
            ("y", "z"),
            "targets must have shape (5, entries), one for each demonstration, got (4, 2)",
        ),
        (
            torch.zeros(5),
            ("y",),
            "targets must have shape (5, entries), one for each demonstration, got (5,)",
        ),
        (
            torch.zeros(5, 2),
            ("y", "y"),
            "target_names must be 2 different names, one per entry, got ('y', 'y')",
        ),
        (
            torch.full((5, 1), torch.nan),
            ("y",),
            "targets must be finite, got nan of demonstration 0",
        ),
        (None, ("y",), "target_names must come with targets, got ('y',) alone"),
    ],
)
def test_malformed_targets_are_refused(targets, names, message):
    assert refused(Demonstrations, walk(5, 4, 2), 0.1, ("a", "b"), targets, names) == message


def test_demonstrations_without_targets_cannot_be_told_apart_by_them():
    assert (
        refused(Demonstrations(walk(2, 5, 1), 0.1, ("x",)).by_target)
        == "demonstrations must have targets, got none"
    )
