"""LeRobot: what its writers wrote, in versions 2 and 3, comes back without actions."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_demonstrations, load_recordings

pa = pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'torch_pmil[formats]'")
pq = pytest.importorskip("pyarrow.parquet")
WRITTEN = Path(__file__).parents[2] / "reference" / "lerobot_v3"  # see the README there
LENGTHS = (20, 24, 18)


@pytest.fixture
def data_set(tmp_path: Path) -> Path:
    return Path(shutil.copytree(WRITTEN, tmp_path / "reach"))


def file_of(data_set: Path) -> Path:
    return data_set / "data" / "chunk-000" / "file-000.parquet"


def as_version_2(data_set: Path) -> Path:
    """A file for each episode, and lists of no fixed size, as some of its writers leave them."""
    state = pq.read_table(file_of(data_set))["observation.state"]
    changed(data_set, "observation.state", state.cast(pa.list_(pa.float32())))
    table = pq.read_table(file_of(data_set))
    for episode in range(3):
        own = table.filter(pa.compute.equal(table["episode_index"], episode))
        pq.write_table(own, file_of(data_set).with_name(f"episode_{episode:06d}.parquet"))
    file_of(data_set).unlink()
    return data_set


def changed(data_set: Path, name: str, column: object) -> Path:
    table = pq.read_table(file_of(data_set))
    at = table.schema.get_field_index(name)
    pq.write_table(
        table.remove_column(at) if column is None else table.set_column(at, name, column),
        file_of(data_set),
    )
    return data_set


def test_episodes_that_lerobot_wrote_come_back(data_set: Path) -> None:
    recordings = load_recordings(data_set)
    assert (recordings.labels, recordings.format) == (("0", "1", "2"), "LeRobot")
    assert recordings.names == ("shoulder.pos", "elbow.pos")
    recorded = zip(LENGTHS, recordings.times, recordings.values, strict=True)
    for episode, (length, times, values) in enumerate(recorded):
        s = np.linspace(0, 1, length)
        np.testing.assert_allclose(values, np.stack([s, episode + s**2], 1), atol=1e-6)
        even = torch.arange(length, dtype=torch.float64) / 30
        torch.testing.assert_close(times, even, rtol=0, atol=1e-12)


def test_version_2_holds_the_same(data_set: Path) -> None:
    new, old = load_recordings(WRITTEN), load_recordings(as_version_2(data_set))
    assert (new.labels, new.names) == (old.labels, old.names)
    assert all(map(torch.equal, new.values + new.times, old.values + old.times))


def test_single_file_is_read_at_even_times_without_names(data_set: Path) -> None:
    alone, whole = load_recordings(file_of(data_set)), load_recordings(data_set)
    assert alone.names == ("observation.state_0", "observation.state_1")
    assert all(map(torch.equal, alone.values, whole.values))
    for own, times in zip(alone.times, whole.times, strict=True):
        torch.testing.assert_close(own, times, rtol=0, atol=1e-6)
        assert own.diff().std() < 1e-12


def test_entries_are_chosen_by_name_and_number(data_set: Path) -> None:
    recordings = load_recordings(data_set, keys=["elbow.pos", "observation.object_1"])
    assert recordings.names == ("elbow.pos", "observation.object_1")
    elbow, entry = recordings.values[1].mT
    assert torch.equal(elbow, load_recordings(data_set).values[1][:, 1]) and (entry == 2).all()


def test_names_that_two_columns_share_are_those_of_the_first(data_set: Path) -> None:
    information = data_set / "meta" / "info.json"
    content = json.loads(information.read_text())
    content["features"]["observation.object"]["names"] = {
        "left": ["shoulder.pos"],
        "right": ["elbow.pos", "wrist.pos"],
    }
    information.write_text(json.dumps(content))
    recordings = load_recordings(data_set, keys=["observation.state", "observation.object"])
    objects = [f"observation.object_{number}" for number in range(3)]
    assert recordings.names == ("shoulder.pos", "elbow.pos", *objects)
    content["features"]["observation.object"]["names"] = {"left": ["a"], "right": ["b", "c"]}
    information.write_text(json.dumps(content))
    assert load_recordings(data_set, keys=["observation.object"]).names == ("a", "b", "c")


def test_actions_are_never_read(data_set: Path) -> None:
    objects = ", ".join(f"observation.object_{number}" for number in range(3))
    held = f"observation.state (shoulder.pos, elbow.pos), observation.object ({objects})"
    for hidden in ("action", "action_0", "timestamp"):
        complaint = f"{data_set}: keys must be some of {held}, got {hidden}"
        assert refused(load_recordings, data_set, keys=[hidden]) == complaint


def test_uneven_timestamps_stay_as_they_are(data_set: Path) -> None:
    stamps = pq.read_table(file_of(data_set))["timestamp"].to_numpy().copy()
    stamps[5] += 0.01
    recordings = load_recordings(changed(data_set, "timestamp", pa.array(stamps)))
    assert np.array_equal(recordings.times[0], stamps[:20].astype(np.float64))
    assert torch.equal(recordings.times[1], load_recordings(WRITTEN).times[1])


def test_episodes_of_one_length_are_demonstrations(data_set: Path) -> None:
    episodes = pa.array(np.repeat([0, 1, 2, 3], [15, 15, 15, 17]))
    stamps = pa.array((np.r_[np.tile(np.arange(15), 3), np.arange(17)] / 30).astype(np.float32))
    changed(changed(data_set, "episode_index", episodes), "timestamp", stamps)
    assert "demonstration 3 must have 15 samples like demonstration 0, got 17" in refused(
        load_demonstrations, data_set
    )
    stamps = pa.array((np.r_[np.tile(np.arange(15), 4), [15, 16]] / 30).astype(np.float32))
    table = pq.read_table(file_of(changed(data_set, "timestamp", stamps))).slice(0, 60)
    pq.write_table(table, file_of(data_set))
    assert load_demonstrations(data_set, 1 / 30).positions.shape == (4, 15, 2)


STATE, FILE = "observation.state", "data/chunk-000/file-000.parquet"
PAIRS = [[0.0, 1.0]] * 62
MALFORMED = {
    f"{FILE}: column timestamp is missing, found ": ("timestamp", None),
    "keys must be some of observation.object (": (STATE, None),
    "row 20, column episode_index must hold a number, got none": (
        "episode_index",
        pa.array([0] * 20 + [None] * 42),
    ),
    f"{FILE}: row 61, column {STATE} must hold numbers like row 0, got [0.0]": (
        STATE,
        pa.array([*PAIRS[:61], [0.0]]),
    ),
    "demonstration 1, sample 2, shoulder.pos must be a finite number, got nan": (
        STATE,
        pa.array([*PAIRS[:22], [None, 1.0], *PAIRS[23:]]),
    ),
}


@pytest.mark.parametrize("message", MALFORMED)
def test_malformed_frames_are_refused_naming_the_place(data_set: Path, message: str) -> None:
    complaint = refused(load_recordings, changed(data_set, *MALFORMED[message]))
    assert complaint.startswith(f"{data_set}: {message}")


def test_malformed_information_is_refused(data_set: Path) -> None:
    info = data_set / "meta" / "info.json"
    info.write_text(json.dumps({**json.loads(info.read_text()), "fps": "fast"}))
    complaint = f"{data_set}: meta/info.json must hold a positive fps and features, got fps fast"
    assert refused(load_recordings, data_set) == complaint
    info.write_text("{")
    complaint = f"{data_set}: not a readable LeRobot data set ("
    assert refused(load_recordings, data_set).startswith(complaint)


def test_data_set_without_frames_is_refused(data_set: Path) -> None:
    file = file_of(data_set)
    pq.write_table(pq.read_table(file).slice(0, 0), file)
    assert refused(load_recordings, data_set).startswith(f"{data_set}: ")
    file.write_bytes(file.read_bytes()[:-40])
    complaint = f"{data_set}: {FILE}: not a readable Parquet file ("
    assert refused(load_recordings, data_set).startswith(complaint)
    file.unlink()
    complaint = "a LeRobot data set must hold files data/chunk-*/*.parquet, found none"
    assert refused(load_recordings, data_set) == f"{data_set}: {complaint}"


def test_columns_that_are_not_asked_for_may_be_ragged_or_twice(data_set: Path) -> None:
    ragged = pa.array([[0.0] * (row % 3) if row % 5 else None for row in range(62)])
    changed(data_set, "observation.object", ragged)
    table = pq.read_table(file_of(data_set))
    for name in ("observation.twice", "observation.twice", "note"):
        table = table.append_column(name, pa.array(["?"] * 62))
    pq.write_table(table, file_of(data_set))
    read, whole = load_recordings(data_set), load_recordings(WRITTEN)
    assert read.names == whole.names and all(map(torch.equal, read.values, whole.values))
    message = "column observation.object must hold numbers like row 0, got "
    assert message in refused(load_recordings, data_set, keys=["observation.object"])
    pq.write_table(table.select(["episode_index", "timestamp", "note"]), file_of(data_set))
    message = "columns observation... of numbers are missing, found episode_index, timestamp, note"
    assert refused(load_recordings, data_set) == f"{data_set}: {FILE}: {message}"
