"""Demonstrations: what is refused, and that files hold what was saved."""

import os

import numpy as np
import pytest
import torch

from reproduction.teachers.reaching import TRAINING_TARGETS
from tests.helpers.draws import Draws
from tests.helpers.refusal import refused
from torch_pmil.demonstrations import (
    Demonstrations,
    Recordings,
    load_demonstrations,
    load_recordings,
    shipped_demonstrations,
)


def walk(*shape):
    return Draws(0).normal(*shape).cumsum(dim=1)


def write_npz(path, **changes):
    arrays = {"positions": walk(3, 5, 2).numpy(), "time_step": 0.1, "names": np.array(["x", "y"])}
    arrays = {name: value for name, value in {**arrays, **changes}.items() if value is not None}
    np.savez(path, **arrays)
    return path


ROWS = [f"{label},{0.1 * step},{step},{label * step}" for label in (1, 2) for step in range(4)]
CSV = ["demonstration,time,x,y", *ROWS]
REACHES = [  # four demonstrations, two of each target
    f"{CSV[0]},target place,target height",
    *(f"{letter}{row},{place},0.5" for letter, place in ("a0", "b2") for row in ROWS),
]


def write_csv(path, lines):
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def with_row(lines, number, text):
    return [*lines[: number - 1], text, *lines[number:]]


NOT_FINITE = walk(2, 5, 2)
NOT_FINITE[1, 3, 1] = torch.nan
FIVE = walk(5, 4, 2), "ab"
MALFORMED = {  # the arguments beside the time step
    "positions must have shape (demonstrations, steps, columns), got (3, 5)": (walk(3, 5), "x"),
    "names must be 2 different names, one per column, got ('x',)": (walk(2, 5, 2), "x"),
    "positions must be finite, got nan in demonstration 1, step 3, column y": (NOT_FINITE, "xy"),
    "targets must have shape (5, entries), one for each demonstration, got (4, 2)": [
        *FIVE,
        torch.zeros(4, 2),
        "yz",
    ],
    "targets must have shape (5, entries), one for each demonstration, got (5,)": [
        *FIVE,
        torch.zeros(5),
        "y",
    ],
    "target_names must be different, one per entry, got 'y' 2 times": [
        *FIVE,
        torch.zeros(5, 2),
        "yy",
    ],
    "targets must be finite, got nan of demonstration 0": [
        *FIVE,
        torch.full((5, 1), torch.nan),
        "y",
    ],
    "target_names must come with targets, got ('y',) alone": [*FIVE, None, "y"],
}


@pytest.mark.parametrize("message", MALFORMED)
def test_malformed_demonstrations_are_refused(message):
    positions, names, *targets = MALFORMED[message]
    assert refused(Demonstrations, positions, 0.1, names, *targets) == message


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


def test_missing_files_and_other_kinds_are_refused(tmp_path):
    for name in ("none.npz", "none.csv"):
        with pytest.raises(FileNotFoundError):
            load_demonstrations(tmp_path / name)
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
        *(lambda file, content=content: content for content in (b"no archive", b"PK\3\4 cut")),
        *(lambda file, cut=cut: file[:cut] for cut in (10, 200, 400, -30)),
        lambda file: file[:250] + bytes([file[250] ^ 0xFF]) + file[251:],
    ],
)
def test_damaged_npz_is_refused(tmp_path, damage):
    path = write_npz(tmp_path / "walks.npz")
    path.write_bytes(damage(path.read_bytes()))
    assert refused(load_demonstrations, path).startswith(f"{path}: not a readable NPZ file")


MALFORMED_NPZ = {
    "array positions is missing, found ['names', 'time_step']": {"positions": None},
    "array time_step is missing, found ['names', 'positions']": {"time_step": None},
    "array names is missing, found ['positions', 'time_step']": {"names": None},
    "arrays positions and time_step must hold real numbers": {
        "positions": np.full((2, 3, 1), "a"),
    },
    "array time_step must be one number and names a list of text": {"time_step": np.ones(2)},
    "positions must hold at least two demonstrations, got 1": {"positions": walk(1, 3, 2)},
    "array targets must hold real numbers and target_names be a list of text": {
        "targets": np.array([["a"]] * 3),
        "target_names": np.array(["y"]),
    },
}


@pytest.mark.parametrize("message", MALFORMED_NPZ)
def test_malformed_arrays_are_refused_naming_the_file(tmp_path, message):
    path = write_npz(tmp_path / "walks.npz", **MALFORMED_NPZ[message])
    assert refused(load_demonstrations, path) == f"{path}: {message}"


def test_time_step_of_the_file_must_be_the_expected_one(tmp_path):
    path = write_npz(tmp_path / "walks.npz")
    assert load_demonstrations(path, time_step=0.1).time_step == 0.1
    complaint = f"{path}: time_step must be 0.05 s, got 0.1 s"
    assert refused(load_demonstrations, path, 0.05) == complaint


def test_csv_holds_one_sample_per_row(tmp_path):
    demonstrations = load_demonstrations(write_csv(tmp_path / "walks.csv", CSV))
    steps = torch.arange(4.0, dtype=torch.float64)
    expected = torch.stack([torch.stack([steps, label * steps], -1) for label in (1, 2)])
    assert torch.equal(demonstrations.positions, expected)
    assert demonstrations.names == ("x", "y")
    assert demonstrations.time_step == pytest.approx(0.1)


MALFORMED_CSV = {
    "must be a CSV file, got an empty file": [],
    "row 1 must be demonstration,time,NAME,..., got time,x,y": with_row(CSV, 1, "time,x,y"),
    "at least two demonstrations are needed, got 1": CSV[:5],
    "demonstration 2 must have 4 samples like demonstration 1, got 3; pmil align makes them one "
    "length": CSV[:-1],
    "row 3 must have 4 columns, got 3": with_row(CSV, 3, "1,0.1,5"),
    "row 3, column x must be a finite number, or left out by keys, got 'five'": with_row(
        CSV, 3, "1,0.1,five,0"
    ),
    "row 3, column y must be a finite number, or left out by keys, got 'nan'": with_row(
        CSV, 3, "1,0.1,5,nan"
    ),
    "row 9, time must follow the sample before it by 0.1 s, got 0.2 s; pmil align makes steps one "
    "length": with_row(CSV, 9, "2,0.4,5,0"),
    "row 3, time must increase, got 0.0 s after 0.0 s": with_row(CSV, 3, "1,0.0,5,0"),
    "row 1 must hold a column x once, got 2 of them": (with_row(CSV, 1, "demonstration,time,x,x")),
    "row 4, column target height must be 0.5 as in row 2 of the same demonstration, got 0.7": (
        with_row(REACHES, 4, REACHES[3].replace(",0,0.5", ",0,0.7"))
    ),
    "row 1 must hold a column target place once, got 2 of them": (
        with_row(REACHES, 1, REACHES[0].replace("height", "place"))
    ),
    "each target must have at least two demonstrations, got one of [2.0, 0.5]": REACHES[:-4],
    "row 1 must be demonstration,time,NAME,..., got demonstration,time,target x,target y": (
        with_row(CSV, 1, "demonstration,time,target x,target y")
    ),
    "row 2, column target height must be a finite number, got '0.5?'": (
        with_row(REACHES, 2, f"{REACHES[1]}?")
    ),
}


@pytest.mark.parametrize("message", MALFORMED_CSV)
def test_malformed_csv_is_refused_naming_file_and_row(tmp_path, message):
    path = write_csv(tmp_path / "walks.csv", MALFORMED_CSV[message])
    assert refused(load_demonstrations, path) == f"{path}: {message}"


def test_csv_gives_the_target_of_each_demonstration(tmp_path):
    path = write_csv(tmp_path / "reaches.csv", REACHES)
    for loaded in (load_demonstrations(path), load_recordings(path)):
        assert loaded.targets.tolist() == [[0, 0.5], [0, 0.5], [2, 0.5], [2, 0.5]]
        assert loaded.targets.dtype == torch.float64
        assert (loaded.names, loaded.target_names) == (("x", "y"), ("place", "height"))
    plain = load_demonstrations(write_csv(tmp_path / "walks.csv", CSV))
    assert torch.equal(load_demonstrations(path).positions, plain.positions.repeat(2, 1, 1))
    assert plain.targets is None


def test_columns_of_targets_may_stand_anywhere_after_the_time(tmp_path):
    loaded = load_demonstrations(write_csv(tmp_path / "reaches.csv", REACHES))
    cells = [line.split(",") for line in REACHES]
    lines = [",".join([*line[:2], line[4], line[2], line[5], line[3]]) for line in cells]
    moved = load_demonstrations(write_csv(tmp_path / "moved.csv", lines))
    assert torch.equal(moved.positions, loaded.positions)
    assert torch.equal(moved.targets, loaded.targets)
    assert (moved.names, moved.target_names) == (loaded.names, loaded.target_names)


def test_recordings_have_lengths_and_times_of_their_own(tmp_path):
    lines = with_row(CSV[:-1], 3, "1,0.15,1,1")
    recordings = load_recordings(write_csv(tmp_path / "walks.csv", lines))
    assert (recordings.labels, recordings.names) == (("1", "2"), ("x", "y"))
    for times, expected in zip(recordings.times, ([0, 0.15, 0.2, 0.3], [0, 0.1, 0.2]), strict=True):
        assert times.tolist() == pytest.approx(expected)
    first, second = (values.tolist() for values in recordings.values)
    assert first == [[0, 0], [1, 1], [2, 2], [3, 3]] and second == [[0, 0], [1, 2], [2, 4]]


@pytest.mark.parametrize("made", [np.array, list, torch.tensor], ids=["array", "list", "tensor"])
def test_recordings_are_made_of_numbers_in_memory_of_any_kind(made):
    times, values = [made([0, 1, 2]), made([0, 2])], [made([[1], [2], [4]]), made([[3], [5]])]
    recordings = Recordings([1, 2], times, values, ["x"], made([[0], [1]]), ["place"])
    assert (recordings.labels, recordings.names) == (("1", "2"), ("x",))
    for found in (*recordings.times, *recordings.values, recordings.targets):
        assert found.dtype == torch.float64
    assert [one.tolist() for one in recordings.values] == [[[1], [2], [4]], [[3], [5]]]
    assert recordings.durations == [2, 2]
    assert refused(Recordings, ["1"], [["now"]], [[[1.0]]], ["x"]).startswith("times must be an")


def test_shipped_demonstrations_swing_up_and_balance():
    demonstrations = shipped_demonstrations("double_pendulum")
    assert demonstrations.positions.shape == (5, 26, 4)
    assert demonstrations.names == ("x1", "y1", "x2", "y2")
    assert demonstrations.duration == pytest.approx(2.5)
    hanging, upright = (torch.tensor([0, sign * 0.5, 0, sign * 1.0]) for sign in (-1, 1))
    assert ((demonstrations.positions[:, 0] - hanging).norm(dim=-1) < 0.5).all()
    assert ((demonstrations.positions[:, 20:] - upright).norm(dim=-1) < 0.25).all()
    inner, outer = demonstrations.positions.split(2, dim=-1)  # links of constant length
    for link in (inner, outer - inner):
        assert (link.norm(dim=-1) - 0.5).abs().max() < 1e-12


def test_shipped_demonstrations_with_targets_hold_the_tip_at_each_target_and_stand_still():
    demonstrations = shipped_demonstrations("double_pendulum_targets")
    assert demonstrations.names == ("x1", "y1", "x2", "y2")
    assert demonstrations.target_names == ("x", "y")
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


TWO = torch.tensor([[0.0, 1.0]] * 2 + [[2.0, 3.0]] * 3)
REACHING = Demonstrations(walk(5, 4, 2), 0.1, ("a", "b"), TWO, ("y", "z"))


def test_demonstrations_are_parted_by_their_targets():
    targets, sets = REACHING.by_target()
    assert targets.tolist() == [[0.0, 1.0], [2.0, 3.0]] and targets.dtype == torch.float64
    assert [one.positions.shape[0] for one in sets] == [2, 3]
    assert torch.equal(torch.cat([one.positions for one in sets]), REACHING.positions)
    plain = Demonstrations(walk(2, 5, 1), 0.1, ("x",))
    assert refused(plain.by_target) == "demonstrations must have targets, got none"


@pytest.mark.parametrize("saved", [Demonstrations(walk(3, 5, 2), 0.1, ("x", "y")), REACHING])
def test_saved_demonstrations_load_unchanged(tmp_path, saved):
    saved.save(tmp_path / "d.npz")
    loaded = load_demonstrations(tmp_path / "d.npz")
    assert torch.equal(loaded.positions, saved.positions)
    assert (loaded.time_step, loaded.names) == (saved.time_step, saved.names)
    assert loaded.target_names == saved.target_names
    assert loaded.targets is saved.targets is None or torch.equal(loaded.targets, saved.targets)
