"""HDF5: what Minari and robomimic write comes back; errors name demonstration and key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_demonstrations, load_recordings
from torch_pmil.demonstrations.errors import TIME_STEP

h5py = pytest.importorskip("h5py", reason="needs h5py: pip install 'torch_pmil[formats]'")
LENGTHS = (5, 7, 6)
NO_RATE = f"{TIME_STEP} must be given, in s: the file does not say how often it was sampled"


def walk(length: int, width: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(length, width)).cumsum(0)


@pytest.fixture
def robomimic(tmp_path: Path) -> Path:
    """As ``dataset_states_to_obs.py`` of robomimic 0.3.0 writes; with twelve, order matters."""
    path = tmp_path / "low_dim.hdf5"
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for number in range(12):
            length = 4 + number
            demo = data.create_group(f"demo_{number}")
            demo.create_dataset("actions", data=np.full((length, 7), 9.0))
            for name, shape in (("states", (length, 30)), ("rewards", length), ("dones", length)):
                demo.create_dataset(name, data=np.zeros(shape))
            for group in ("obs", "next_obs"):
                observed = {
                    "robot0_eef_pos": walk(length, 3, number),
                    "robot0_gripper": np.arange(length),
                    "agentview_image": np.zeros((length, 8, 8, 3), np.uint8),
                }
                for name, values in observed.items():
                    demo.create_dataset(f"{group}/{name}", data=values, compression="gzip")
            demo.attrs["num_samples"] = length
        data.attrs["total"] = 12
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 20}}
        )
    return path


def test_chosen_observations_of_robomimic_come_in_order_at_its_control_frequency(
    robomimic: Path,
) -> None:
    recordings = load_recordings(robomimic, keys=["robot0_gripper", "robot0_eef_pos"])
    assert recordings.names == ("robot0_gripper", *(f"robot0_eef_pos_{n}" for n in range(3)))
    assert recordings.labels == tuple(f"demo_{number}" for number in range(12))
    assert recordings.format == "robomimic"
    for number, (times, values) in enumerate(zip(recordings.times, recordings.values, strict=True)):
        length = 4 + number
        assert np.array_equal(values[:, 1:], walk(length, 3, number))
        assert values[:, 0].tolist() == list(range(length))
        torch.testing.assert_close(times, torch.arange(length, dtype=torch.float64) / 20)


def test_single_entries_are_chosen_by_number_and_time_step_by_hand(robomimic: Path) -> None:
    with h5py.File(robomimic, "a") as file:
        del file["data"].attrs["env_args"]
    recordings = load_recordings(
        robomimic, keys=["robot0_eef_pos_2", "robot0_eef_pos_0"], names=["z", "x"], time_step=0.5
    )
    assert np.array_equal(recordings.values[3], walk(7, 3, 3)[:, [2, 0]])
    assert recordings.names == ("z", "x")
    assert recordings.durations[0] == 1.5


def test_time_step_must_be_that_of_the_file(robomimic: Path) -> None:
    assert load_recordings(robomimic, keys=[PLACE], time_step=0.05).times[0][1] == 0.05
    complaint = refused(load_recordings, robomimic, keys=[PLACE], time_step=0.5)
    control_freq = "by its control_freq the file has a sample every 0.05 s, got 0.5"
    assert complaint == f"{robomimic}: {TIME_STEP} must be left out: {control_freq}"


def test_keys_of_robomimic_must_be_chosen_among_observed_numbers(robomimic: Path) -> None:
    numbers = (
        "robot0_eef_pos (robot0_eef_pos_0, robot0_eef_pos_1, robot0_eef_pos_2), robot0_gripper"
    )
    complaint = f"{robomimic}: keys must say what to read: some of {numbers}"
    assert refused(load_recordings, robomimic) == complaint
    for hidden in ("actions", "agentview_image", "../actions"):
        complaint = f"{robomimic}: keys must be some of {numbers}, got {hidden}"
        assert refused(load_recordings, robomimic, keys=[hidden]) == complaint


PLACE, GRIPPER = "robot0_eef_pos", "robot0_gripper"
NO_SAMPLES = (
    "demonstration demo_1 must hold 3 entries at each of at least one time, got (0, 3) at 0 times"
)


@pytest.mark.parametrize(
    ("changes", "keys", "message"),
    [
        (
            {f"demo_3/obs/{GRIPPER}": np.arange(5)},
            [GRIPPER, PLACE],
            f"demo_3, {GRIPPER} must have 7 samples like {PLACE}, got 5",
        ),
        (
            {f"demo_3/obs/{GRIPPER}": None},
            [GRIPPER],
            f"demo_3 must hold {GRIPPER} in the shape of the first demonstration",
        ),
        (
            {f"demo_2/obs/{PLACE}": np.array([3 * [0.0], [0.0, 0.0, np.nan]])},
            [PLACE],
            f"demonstration demo_2, sample 1, {PLACE}_2 must be a finite number, got nan",
        ),
        ({f"demo_1/obs/{PLACE}": np.zeros((0, 3))}, [PLACE], NO_SAMPLES),
        ({"env_args": None}, [PLACE], NO_RATE),
    ],
)
def test_damaged_structure_names_demonstration_and_key(
    robomimic: Path, changes: dict, keys: list[str], message: str
) -> None:
    with h5py.File(robomimic, "a") as file:
        for path, values in changes.items():
            holder = file["data"] if path in file["data"] else file["data"].attrs
            del holder[path]
            if values is not None:
                holder[path] = values
    assert refused(load_recordings, robomimic, keys=keys) == f"{robomimic}: {message}"


@pytest.mark.parametrize("part", [0.01, 0.3, 0.9])
def test_truncated_hdf5_is_refused(robomimic: Path, part: float) -> None:
    content = robomimic.read_bytes()
    robomimic.write_bytes(content[: int(part * len(content))])
    complaint = refused(load_recordings, robomimic, keys=["robot0_gripper"])
    assert complaint.startswith(f"{robomimic}: not a readable HDF5 file (")


@pytest.fixture
def minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three episodes of a reach, written by Minari's storage; the observations are a dictionary."""
    written = pytest.importorskip(
        "minari.dataset.minari_storage", reason="needs minari to write what is read"
    )
    from_buffer = pytest.importorskip("minari.data_collector.episode_buffer").EpisodeBuffer
    spaces = pytest.importorskip("gymnasium").spaces
    space = spaces.Dict(
        {"hand": spaces.Box(-10, 10, (2,)), "goal": spaces.Dict({"at": spaces.Box(-10, 10, (1,))})}
    )
    (tmp_path / "reach-v0").mkdir()
    storage = written.MinariStorage.new(
        tmp_path / "reach-v0" / "data", space, spaces.Box(-9, 9, (1,))
    )
    storage.update_episodes(
        from_buffer(
            id=number,
            observations={
                "hand": walk(length, 2, number),
                "goal": {"at": np.full((length, 1), number)},
            },
            actions=np.full((length - 1, 1), 9.0),
            rewards=[0.0] * (length - 1),
            terminations=[False] * (length - 1),
            truncations=[False] * (length - 1),
        )
        for number, length in enumerate(LENGTHS)
    )
    return tmp_path / "reach-v0"


def test_observations_that_minari_wrote_come_back(minari: Path) -> None:
    recordings = load_recordings(minari, keys=["hand", "goal/at"], time_step=0.05)
    assert (recordings.format, recordings.names) == ("Minari", ("hand_0", "hand_1", "goal/at_0"))
    assert recordings.labels == ("episode_0", "episode_1", "episode_2")
    for number, (length, values) in enumerate(zip(LENGTHS, recordings.values, strict=True)):
        np.testing.assert_allclose(values[:, :2], walk(length, 2, number), rtol=1e-6)
        assert values[:, 2].tolist() == [number] * length
    file = minari / "data" / "main_data.hdf5"
    again = load_recordings(file, keys=["hand", "goal/at"], time_step=0.05)
    assert all(map(torch.equal, recordings.values, again.values))
    within = load_recordings(minari / "data", keys=["hand"], time_step=0.05)
    assert within.labels == recordings.labels


def test_minari_has_no_times_and_its_keys_are_chosen(minari: Path) -> None:
    assert refused(load_recordings, minari, keys=["hand"]) == f"{minari}: {NO_RATE}"
    message = "keys must say what to read: some of goal/at (goal/at_0), hand (hand_0, hand_1)"
    assert refused(load_recordings, minari, time_step=0.1) == f"{minari}: {message}"


def test_only_observation_of_minari_is_read_without_asking(minari: Path) -> None:
    with h5py.File(minari / "data" / "main_data.hdf5", "a") as file:
        for number in range(3):
            del file[f"episode_{number}/observations"]
            file[f"episode_{number}/observations"] = walk(4, 2, number)
    shown = load_demonstrations(minari, 0.1)
    assert shown.names == ("observations_0", "observations_1")
    assert shown.time_step == pytest.approx(0.1)
    assert np.array_equal(shown.positions[2], walk(4, 2, 2))


def test_other_hdf5_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["weights"] = np.zeros(3)
    groups = "data/demo_N (robomimic) or episode_N (Minari)"
    complaint = f"an HDF5 file must hold groups {groups}, found ['weights']"
    assert refused(load_recordings, tmp_path / "other.h5").endswith(f".h5: {complaint}")


def test_minari_of_another_storage_is_refused(minari: Path) -> None:
    metadata = minari / "data" / "metadata.json"
    metadata.write_text(metadata.read_text().replace('"hdf5"', '"arrow"'))
    complaint = f"{minari}: data_format of a Minari data set must be hdf5, got arrow"
    assert refused(load_recordings, minari) == complaint
    metadata.write_text("{")
    complaint = f"{minari}: not a readable Minari data set ("
    assert refused(load_recordings, minari).startswith(complaint)


def test_wide_data_set_that_is_not_asked_for_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "wide.hdf5"
    with h5py.File(path, "w") as file:
        for number in range(2):
            file[f"data/demo_{number}/obs/q"] = np.arange(5).astype(">f8")
            file[f"data/demo_{number}/obs/picture"] = np.zeros((5, 20_000), np.uint8)
    read = load_recordings(path, keys=["q"], time_step=0.1)
    assert [one.flatten().tolist() for one in read.values] == [[0.0, 1.0, 2.0, 3.0, 4.0]] * 2
    message = f"{path}: there must be at most 10000 entries, got 20000"
    assert refused(load_recordings, path, keys=["picture"], time_step=0.1) == message
    with h5py.File(path, "w") as file:
        file.create_group("data/demo_0/obs")
    message = f"{path}: demo_0/obs must hold data sets of numbers, found none"
    assert refused(load_recordings, path, time_step=0.1) == message
