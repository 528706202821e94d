"""What a learning run leaves in its folder, on the first four steps of the double pendulum."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, fields
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.short_run import quick_fits as shorten_fits, short_experiment
from torch_pmil.control.policy_file import load_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.demonstrations.distribution import demonstration_spread, rms_error
from torch_pmil.envs.rollouts import rollout_of
from torch_pmil.model.calibration import two_sigma_coverage, two_sigma_coverage_by_entry
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.rollout import PredictionError, predict_trajectory
from torch_pmil.runs import training
from torch_pmil.runs.lock import RunGoingOnError
from torch_pmil.runs.own_files import files_of, own
from torch_pmil.runs.report import write_report
from torch_pmil.runs.run_folder import (
    open_logger,
    remove_debris,
    rewind_logs,
    save_tensors,
)
from torch_pmil.runs.summaries import RunError, read_summary
from torch_pmil.runs.training import RunResult, train
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.tasks.task import MEASURED_STARTS, Task
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Candidate, Trial

HORIZON, TRIALS, SEED = 4, 2, 3
COMMAND = f"pmil train seed={SEED}"


@pytest.fixture(scope="module")
def experiment() -> Task:
    return short_experiment(HORIZON)


@pytest.fixture(scope="module", autouse=True)
def quick_fits() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        shorten_fits(patch)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Is made by the run."""
    return tmp_path_factory.mktemp("runs") / "double_pendulum" / "seed_3"


@pytest.fixture(scope="module")
def result(experiment: Task, folder: Path) -> RunResult:
    """Metrics hold each trial as soon as it is reported."""

    def on_trial(trial: Trial) -> None:
        assert len(read_metrics(folder)) == trial.trial

    return train(experiment, SEED, TRIALS, folder, COMMAND, progress_bar=False, on_trial=on_trial)


@pytest.fixture(scope="module")
def summary(result: RunResult, folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


def read_metrics(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_run_leaves_these_files_with_a_row_for_each_trial_and_no_temporary_ones(
    result: RunResult, folder: Path
) -> None:
    files = {"dynamics.pt", "metrics.csv", "policy.pt", "run.json", "settings.yaml", "summary.json"}
    assert {*os.listdir(folder)} == files | {"checkpoints", "figures", "run_files.json"}
    listed = {name for name in files_of(folder) if name.startswith("checkpoints/")}
    assert files_of(folder) - listed == files
    assert {f"checkpoints/{name}" for name in os.listdir(folder / "checkpoints")} <= listed
    assert os.listdir(folder / "figures") == []
    rows = read_metrics(folder)
    assert list(rows[0]) == [field.name for field in fields(Trial)]
    trials = [asdict(trial).items() for trial in result.trials]
    assert rows == [{k: "" if v is None else str(v) for k, v in items} for items in trials]


def test_summary_says_what_was_run(summary: dict, experiment: Task) -> None:
    named = (summary["experiment"], summary["seed"], summary["command"])
    assert named == ("double_pendulum", SEED, COMMAND)
    assert datetime.fromisoformat(summary["date"]).utcoffset().total_seconds() == 0
    assert summary["commit"] and summary["versions"]["torch"] == version("torch")
    others = {"python", "torch_pmil", "gpytorch", "torchrl", "tensordict", "mujoco", "numpy"}
    assert others <= summary["versions"].keys()
    settings = summary["settings"]
    expected = {
        "trials": TRIALS,
        "horizon": HORIZON,
        "num_centres": 5,
        "noise_std": 0.05,
        "promise": 0.95,
        "confirmations": 1,
        "optimizer": "LBFGS",
        "search": asdict(experiment.method.search),
        "exploration": {"rollouts": 1, "steps": HORIZON, "random_action": 0.4},
    }
    assert expected.items() <= settings.items()
    more = {"random_action", "initial_weight_std", "tolerance", "input_widths", "holds_start"}
    assert more <= settings.keys()


def test_summary_says_what_came_of_it(summary: dict, result: RunResult, experiment: Task) -> None:
    (outcome,), space = result.outcomes, experiment.space
    predicted, executed = outcome.predicted, outcome.executed
    demonstrations, names = experiment.demonstrations, space.match_space.names
    successes = experiment.error(rollout_of(executed)) <= experiment.tolerance
    by_entry = two_sigma_coverage_by_entry(predicted, executed).tolist()
    errors = rms_error(demonstrations, space.observe(executed)).tolist()
    spread = demonstration_spread(demonstrations).tolist()
    assert len(executed) == MEASURED_STARTS
    expected = {
        "saved_success_rate": successes.double().mean().item(),
        "saved_n_eval": MEASURED_STARTS,
        "two_sigma_coverage": two_sigma_coverage(predicted, executed),
        "two_sigma_coverage_by_entry": dict(zip(space.names, by_entry, strict=True)),
        "rms_error": dict(zip(names, errors, strict=True)),
        "demonstration_spread": dict(zip(names, spread, strict=True)),
        "stop_reason": "limit of trials",
        "trials": [asdict(trial) for trial in result.trials],
        "units": {"objective": "nats", "demonstrations": dict.fromkeys(names, "m")},
    }
    assert expected.items() <= summary.items()
    assert summary["saved_trial"] in (1, 2) and summary["wall_seconds"] > 0 < summary["cpu_seconds"]
    assert summary["experience_s"] == pytest.approx((TRIALS + 1) * HORIZON * 0.1)
    assert len(summary["trials"]) == TRIALS and result.summary == summary


def load_network(folder: Path) -> RBFPolicy:
    return load_policy(folder / "policy.pt").policy


def load_dynamics(folder: Path) -> GPDynamics:
    dynamics = short_experiment().make_dynamics()
    dynamics.load_state_dict(torch.load(folder / "dynamics.pt", weights_only=True))
    return dynamics


@torch.no_grad()
def test_saved_policy_and_model_are_those_that_predicted_and_acted_and_know_all_experience(
    result: RunResult, folder: Path, experiment: Task, draws: Draws
) -> None:
    policy, dynamics, (outcome,) = load_network(folder), load_dynamics(folder), result.outcomes
    features = draws.normal(50, 6)
    assert torch.equal(policy(features), result.policy.policy(features))
    assert dynamics.train_inputs.shape == ((TRIALS + 1) * HORIZON, 8)
    predicted = predict_trajectory(experiment.initial, policy, dynamics, experiment.space, HORIZON)
    assert torch.equal(predicted.mean, outcome.predicted.mean)
    assert torch.equal(predicted.cov, outcome.predicted.cov)
    before, after = outcome.executed[:, :-1].flatten(0, 1), outcome.executed[:, 1:].flatten(0, 1)
    moved = experiment.make_env(seed=0).simulate(before, policy(experiment.space.features(before)))
    torch.testing.assert_close(moved, after, rtol=0, atol=1e-9)


def test_run_whose_model_cannot_predict_the_saved_policy_ends_with_a_summary_that_says_so(
    experiment: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unpredictable(self: TrajectoryLoss, *args: object) -> None:
        raise PredictionError("prediction of step 2 of 4 failed: cov", 2)

    original = PMILTrainer.best_policy

    def best_policy(trainer: PMILTrainer) -> Candidate:
        monkeypatch.setattr(TrajectoryLoss, "predict_states", unpredictable)
        return original(trainer)

    monkeypatch.setattr(PMILTrainer, "best_policy", best_policy)
    result = train(experiment, SEED, 1, tmp_path / "run", COMMAND, progress_bar=False)
    summary = read_summary(tmp_path / "run")
    assert summary["prediction_error"] == "prediction of step 2 of 4 failed: cov"
    assert not {"two_sigma_coverage", "two_sigma_coverage_by_entry", "loss_per_step"} & set(summary)
    (reason,) = summary["diagnosis"]
    assert reason["cause"] == "model not right" and "cannot predict" in reason["message"]
    assert result.outcomes[0].predicted.mean.shape == (HORIZON, experiment.space.dim)
    assert write_report(tmp_path / "run").exists()
    assert load_network(tmp_path / "run")


def test_debris_of_a_killed_run_is_removed_and_nothing_else(tmp_path: Path) -> None:
    checkpoints, hexadecimal = tmp_path / "checkpoints", 32 * "a"
    (checkpoints / f".checkpoint-1.torchrl.stage-{hexadecimal}").mkdir(parents=True)
    (tmp_path / "logs" / "a_seed_0" / "scalars").mkdir(parents=True)
    (tmp_path / "figures").mkdir()
    listed = ("video.mp4", "summary.json", "figures/poses.png", "logs/a_seed_0/scalars/loss.csv")
    for name in listed:
        own(tmp_path, name)
    kept = ("video.mp4", ".hidden.3.txt", ".policy.7.pt", "figures/.a.3.png", "figures/a.png")
    kept += ("run_files.json", "checkpoints/.mine.stage-1", f".x.torchrl.stage-{hexadecimal}")
    debris = (
        *(".video.4711.mp4", ".summary.1.json", "figures/.poses.12.png", ".run_files.9.json"),
        "logs/a_seed_0/scalars/.loss.4711.csv",
        f"checkpoints/.checkpoint-2.torchrl.archive-{hexadecimal}",
    )
    for name in (*kept, *debris):
        (tmp_path / name).touch()
    own(tmp_path, listed[0])  # the list is whole again
    set_aside = checkpoints / f".checkpoint-0.torchrl.backup-{hexadecimal}"
    set_aside.write_text("the only one")
    remove_debris(tmp_path)
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {*kept, "checkpoints/checkpoint-0.torchrl"}
    assert sorted(os.listdir(checkpoints)) == [".mine.stage-1", "checkpoint-0.torchrl"]


def test_rows_of_a_csv_logger_are_taken_back_to_a_step_and_a_cut_one_too(tmp_path: Path) -> None:
    logger, scalars = open_logger("csv", tmp_path, "name", 0), tmp_path / "logs/name_seed_0/scalars"
    for name in ("loss", "late"):
        own(tmp_path, f"logs/name_seed_0/scalars/{name}.csv")
    (scalars / "loss.csv").write_text("2,0.5\n4,nan\n10,0.1\n1")
    for name in ("late", "mine"):  # the run has not listed the second
        (scalars / f"{name}.csv").write_text("10,0.1\n")
    rewind_logs(logger, step=4)
    logger.log_scalar("loss", 0.25, step=10)
    assert {path.name: path.read_text() for path in scalars.iterdir()} == {
        "loss.csv": "2,0.5\n4,nan\n10,0.25\n",
        "mine.csv": "10,0.1\n",
    }
    (scalars / "loss.csv").write_bytes(b"\xff")
    with pytest.raises(RunError, match=r"loss\.csv: must be UTF-8, got"):
        rewind_logs(logger, step=4)


@pytest.mark.parametrize("phase", ["clear_folder", "make_trainer", "_finish"])
def test_run_begins_by_removing_debris_and_is_alone_in_its_folder_from_its_start_to_its_end(
    phase: str, experiment: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def another(*args: object) -> None:
        assert (tmp_path / ".pmil.lock").read_text() == str(os.getpid())
        if phase == "make_trainer":
            made = {".pmil.lock", "figures", "run.json", "settings.yaml", "run_files.json"}
            assert {*os.listdir(tmp_path)} == made
        with ThreadPoolExecutor() as pool:
            second = pool.submit(train, experiment, SEED, 1, tmp_path, COMMAND, resume=True)
        with pytest.raises(RunGoingOnError, match=f"is going on in .* .process {os.getpid()}."):
            second.result()
        raise KeyboardInterrupt

    own(tmp_path, "video.mp4").with_name(".video.4711.mp4").touch()
    monkeypatch.setattr(training, phase, another)
    with pytest.raises(KeyboardInterrupt):
        train(experiment, SEED, 1, tmp_path, COMMAND)
    assert not (tmp_path / ".pmil.lock").exists()


def test_seed_of_numpy_is_that_of_python(
    experiment: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "make_trainer", Mock(side_effect=KeyboardInterrupt))
    written = set()
    for seed in (3, np.int64(3)):
        with pytest.raises(KeyboardInterrupt):
            train(experiment, seed, 1, tmp_path / type(seed).__name__, COMMAND)
        written.add((tmp_path / type(seed).__name__ / "settings.yaml").read_text())
    assert len(written) == 1


def test_saved_tensors_come_back_and_leave_no_temporary_file(tmp_path: Path, draws: Draws) -> None:
    tensors = {"a": draws.normal(3), "b": draws.normal(2, 2)}
    save_tensors(tmp_path / "tensors.pt", tensors)
    loaded = torch.load(tmp_path / "tensors.pt", weights_only=True)
    assert loaded.keys() == tensors.keys()
    assert all(torch.equal(loaded[name], value) for name, value in tensors.items())
    assert os.listdir(tmp_path) == ["tensors.pt"]


@pytest.mark.parametrize("resume", [None, 3])
def test_resume_that_is_no_folder_is_refused(tmp_path: Path, resume: object) -> None:
    with pytest.raises(
        TypeError, match=f"resume must be a bool or the folder of a run, got {resume}"
    ):
        train(short_experiment(), SEED, 1, tmp_path, COMMAND, resume=resume)
    assert not list(tmp_path.iterdir())
