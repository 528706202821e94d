"""Sweeps of the training script: the same numbers whatever starts the runs, and one line for what
is wrong.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

from torch_pmil.control.policy_file import load_policy
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.runs.own_files import LIST

ROOT = Path(__file__).parents[2]
SEEDS = range(4)
SECONDS = {"gp_seconds", "search_seconds"}  # differ from run to run


def train(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    """The script in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "torch_pmil", "train", *overrides]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds the beginning of the demonstrations: five steps."""
    folder = tmp_path_factory.mktemp("sweep")
    whole = shipped_demonstrations()
    replace(whole, positions=whole.positions[:, :6]).save(folder / "short.npz")
    return folder


def sweep(folder: Path, launcher: str) -> subprocess.CompletedProcess[str]:
    """A trial with each seed."""
    run = ("demonstrations=short.npz", "trials=1", f"out={launcher}/seed_${{seed}}")
    return train(folder, "-m", f"seed=range({len(SEEDS)})", *run, f"hydra/launcher={launcher}")


@pytest.fixture(scope="module")
def joblib(folder: Path) -> subprocess.CompletedProcess[str]:
    """A sweep on joblib, whose processes take one run after another."""
    return sweep(folder, "joblib")


def trials_of(run: Path) -> list[dict]:
    """What was measured in each trial, without the seconds it took."""
    trials = json.loads((run / "summary.json").read_text())["trials"]
    return [
        {name: value for name, value in trial.items() if name not in SECONDS} for trial in trials
    ]


def policy_of(run: Path) -> Mapping[str, torch.Tensor]:
    return load_policy(run / "policy.pt").state_dict()


def assert_same_numbers(run: Path, other: Path) -> None:
    assert trials_of(run) == trials_of(other)
    policy, others = policy_of(run), policy_of(other)
    assert policy and all(
        torch.equal(policy[name], others[name]) for name in policy.keys() | others.keys()
    )


@pytest.mark.slow
def test_each_run_of_a_sweep_is_whole_and_tells_its_progress_by_name(
    folder: Path, joblib: subprocess.CompletedProcess[str]
) -> None:
    assert (joblib.returncode, joblib.stderr) == (0, "")
    files = {"metrics.csv", "run.json", "settings.yaml", "summary.json", "policy.pt", "dynamics.pt"}
    files |= {"video.mp4", "video.gif", "report.html", "figures", "checkpoints", "logs", LIST}
    told = joblib.stdout.splitlines()
    for seed in SEEDS:
        run = f"joblib/seed_{seed}"
        assert set(os.listdir(folder / run)) == files
        assert sum(line.startswith(f"{run}: trial  1:   0.5 s of experience") for line in told) == 1
        command = json.loads((folder / run / "summary.json").read_text())["command"]
        assert (
            command == f"pmil train seed={seed} demonstrations=short.npz trials=1 "
            f"'out=joblib/seed_${{seed}}'"
        )
    assert {line.partition(":")[0] for line in told if "is a sketch" not in line} == {
        f"joblib/seed_{seed}" for seed in SEEDS
    }


@pytest.mark.slow
def test_a_run_of_a_sweep_has_the_numbers_of_the_same_run_alone(
    folder: Path, joblib: subprocess.CompletedProcess[str]
) -> None:
    """The last seed's process had another run before."""
    alone = train(folder, f"seed={SEEDS[-1]}", "demonstrations=short.npz", "trials=1", "out=alone")
    assert alone.returncode == 0, alone.stderr
    assert_same_numbers(folder / "alone", folder / "joblib" / f"seed_{SEEDS[-1]}")


@pytest.mark.slow
@pytest.mark.skipif(
    find_spec("hydra_plugins.hydra_ray_launcher") is None, reason="needs the extra ray"
)
def test_ray_gives_the_numbers_that_joblib_gives(
    folder: Path, joblib: subprocess.CompletedProcess[str]
) -> None:
    ray = sweep(folder, "ray")
    assert ray.returncode == 0, ray.stderr
    for seed in SEEDS:
        assert_same_numbers(folder / "ray" / f"seed_{seed}", folder / "joblib" / f"seed_{seed}")


@pytest.mark.slow
def test_runs_that_fail_are_named_and_the_others_go_on(folder: Path) -> None:
    result = train(
        folder, "-m", "seed=x,0", "demonstrations=short.npz", "trials=1", "out=some/seed_${seed}"
    )
    assert result.returncode == 1
    assert result.stderr.startswith(
        "some/seed_x: error: seed must be a whole number from 0 to 2147483647, got 'x'\n"
    )
    assert "Traceback" not in result.stderr
    assert (folder / "some" / "seed_0" / "summary.json").is_file()
    assert not (folder / "some" / "seed_x").exists()


@pytest.mark.slow
def test_runs_that_would_share_a_folder_are_refused_in_one_line(tmp_path: Path) -> None:
    result = train(tmp_path, "-m", "trials=1,2")
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr.startswith(
        "error: two runs would write to runs/double_pendulum/seed_0: trials=1 and trials=2; "
    )
    assert result.stderr.count("\n") == 1
    assert os.listdir(tmp_path) == []
