"""The recording script: what it writes, and that it fails cleanly."""

import os
from functools import partial

import numpy as np
import pytest
import torch

from tests.helpers.run_script import run_script
from torch_pmil.demonstrations import load_demonstrations, shipped_demonstrations
from torch_pmil.envs.hitting_plane import TRAINING_TARGETS

SCRIPT = "scripts/record_demonstrations.py"


@pytest.fixture
def record(monkeypatch):
    """The script, run with command-line overrides."""
    return partial(run_script, monkeypatch, SCRIPT)


@pytest.mark.slow
def test_seed_0_records_the_shipped_demonstrations(record, tmp_path, capsys):
    record("experiment=double_pendulum", "seed=0", f"out={tmp_path / 'recorded.npz'}")
    recorded = load_demonstrations(tmp_path / "recorded.npz")
    torch.testing.assert_close(
        recorded.positions, shipped_demonstrations().positions, rtol=0, atol=1e-6
    )
    assert "peak torque (N·m)" in capsys.readouterr().out
    with np.load(tmp_path / "recorded.npz") as arrays:
        assert sorted(arrays.files) == ["names", "positions", "time_step"]


@pytest.mark.slow
def test_seed_0_records_the_shipped_demonstrations_with_targets(record, tmp_path, capsys):
    record("experiment=double_pendulum_targets", "seed=0", f"out={tmp_path / 'recorded.npz'}")
    recorded, shipped = (
        load_demonstrations(tmp_path / "recorded.npz"),
        shipped_demonstrations("double_pendulum_targets"),
    )
    torch.testing.assert_close(recorded.positions, shipped.positions, rtol=0, atol=1e-6)
    assert torch.equal(recorded.targets, shipped.targets)
    assert (recorded.names, recorded.target_names, recorded.time_step) == (
        shipped.names,
        shipped.target_names,
        shipped.time_step,
    )
    assert "largest distance from the target" in capsys.readouterr().out


@pytest.mark.slow
def test_demonstrator_that_misses_a_target_records_nothing(record, tmp_path):
    with pytest.raises(SystemExit, match=r"a demonstration must stay within 0.1 m, got"):
        record(
            "experiment=double_pendulum_targets",
            "torque_noise=3",
            f"out={tmp_path / 'recorded.npz'}",
        )
    assert os.listdir(tmp_path) == []


def test_missing_folder_is_reported_before_recording(record, tmp_path):
    out = tmp_path / "nowhere" / "recorded.npz"
    with pytest.raises(SystemExit) as stop:
        record(f"out={out}")
    assert stop.value.code == f"cannot write {out}: there is no folder {out.parent}"
    assert os.listdir(tmp_path) == []


def test_unknown_experiment_is_refused(record, tmp_path):
    with pytest.raises(SystemExit) as stop:
        record("experiment=triple", f"out={tmp_path / 'recorded.npz'}")
    known = [
        "acrobot",
        "biorob",
        "biorob_targets",
        "cart_pole",
        "double_pendulum",
        "double_pendulum_targets",
        "gym_pendulum",
        "inverted_pendulum",
        "pendubot",
    ]
    assert stop.value.code == f"experiment must be one of {known}, got triple"


@pytest.mark.slow
def test_path_that_is_a_folder_is_refused_without_leftovers(record, tmp_path):
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(SystemExit, match="cannot record"):
        record(f"out={tmp_path / 'folder.npz'}")
    assert os.listdir(tmp_path) == ["folder.npz"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["gym_pendulum", "inverted_pendulum", "pendubot", "acrobot", "cart_pole"]
)
def test_seed_0_records_the_other_shipped_demonstrations(record, tmp_path, capsys, name):
    record(f"experiment={name}", "seed=0", f"out={tmp_path / 'recorded.npz'}")
    recorded, shipped = load_demonstrations(tmp_path / "recorded.npz"), shipped_demonstrations(name)
    torch.testing.assert_close(recorded.positions, shipped.positions, rtol=0, atol=1e-6)
    assert (recorded.names, recorded.time_step) == (shipped.names, shipped.time_step)
    assert "peak action" in capsys.readouterr().out


def test_teacher_that_fails_records_nothing(record, tmp_path):
    with pytest.raises(SystemExit, match=r"a demonstration must have an error of at most 0.1, got"):
        record(
            "experiment=inverted_pendulum", "torque_noise=30", f"out={tmp_path / 'recorded.npz'}"
        )
    assert os.listdir(tmp_path) == []


def test_seed_0_records_the_shipped_demonstrations_of_the_biorob_without_torques(
    record, tmp_path, capsys
):
    record("experiment=biorob", "seed=0", f"out={tmp_path / 'recorded.npz'}")
    recorded, shipped = (
        load_demonstrations(tmp_path / "recorded.npz"),
        shipped_demonstrations("biorob"),
    )
    assert recorded.positions.shape == (3, 19, 6)
    torch.testing.assert_close(recorded.positions, shipped.positions, rtol=0, atol=1e-4)
    assert (recorded.names, recorded.time_step) == (shipped.names, 0.1)
    assert "time of the hit (s)" in capsys.readouterr().out
    with np.load(tmp_path / "recorded.npz") as arrays:
        assert sorted(arrays.files) == ["names", "positions", "time_step"]


def test_seed_0_records_the_shipped_demonstrations_of_three_balls(record, tmp_path, capsys):
    record("experiment=biorob_targets", "seed=0", f"out={tmp_path / 'recorded.npz'}")
    recorded, shipped = (
        load_demonstrations(tmp_path / "recorded.npz"),
        shipped_demonstrations("biorob_targets"),
    )
    assert recorded.positions.shape == (6, 19, 6)
    torch.testing.assert_close(recorded.positions, shipped.positions, rtol=0, atol=1e-4)
    assert torch.equal(
        recorded.targets, shipped.targets
    ) and recorded.target_names == shipped.target_names == ("y", "z")
    assert (recorded.names, recorded.time_step) == (shipped_demonstrations("biorob").names, 0.1)
    assert capsys.readouterr().out.count(" 1.") == 6, "each hits"


def test_each_training_target_is_demonstrated_twice_and_alike():
    targets, sets = shipped_demonstrations("biorob_targets").by_target()
    assert torch.equal(targets, TRAINING_TARGETS) and [len(one.positions) for one in sets] == [
        2,
        2,
        2,
    ]
    yaw = torch.stack(
        [one.positions[:, 11:15, 0].mean(1) for one in sets]
    )  # (targets, 2), around the hit
    assert torch.pdist(yaw.mean(1, keepdim=True)).min() > 2 * yaw.diff(dim=1).abs().max()


@pytest.mark.parametrize("experiment", ["biorob", "biorob_targets"])
def test_hand_has_no_noise_of_torques(record, tmp_path, experiment):
    with pytest.raises(
        SystemExit,
        match=f"torque_noise must be null for {experiment}, which is led by hand, got 0.2",
    ):
        record(f"experiment={experiment}", "torque_noise=0.2", f"out={tmp_path / 'recorded.npz'}")
    assert os.listdir(tmp_path) == []
