"""A run of the baseline with movement primitives: its start, what it leaves, what it learns."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path

import pytest
import torch

from reproduction.baselines.dmp_learning import execute, random_torques
from reproduction.baselines.dmp_run import DMPTrial, joint_trajectories, random_rollout, run_dmp
from tests.helpers.short_run import quick_fits, short_experiment
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.runs.summaries import find_runs, read_summary, success_over_experience
from torch_pmil.runs.training import make_trainer
from torch_pmil.tasks.double_pendulum import double_pendulum
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

TRIALS, SEED = 2, 3
DIVIDE = "must divide the control period of 0.1 s"
COMMAND = "python scripts/reproduce.py figure7b"
short_run = partial(run_dmp, short_experiment(), SEED, TRIALS, command=COMMAND)


@pytest.fixture(scope="module")
def experiment() -> Task:
    return load_experiment("double_pendulum")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_fits(monkeypatch)


def test_joint_trajectories_show_what_was_demonstrated_and_begin_near_the_robot(
    experiment: Task,
) -> None:
    angles = joint_trajectories(experiment)
    states = torch.stack([angles, torch.zeros_like(angles)], -1).flatten(-2)
    seen = experiment.space.observe(states)
    torch.testing.assert_close(seen, experiment.demonstrations.positions)
    assert (angles[:, 0] - torch.tensor([math.pi, 0.0])).abs().max() < 0.5
    assert angles.diff(dim=1).abs().max() < 1


def test_demonstration_that_begins_beyond_half_a_turn_is_the_same_motion(
    experiment: Task,
) -> None:
    """Arctangents jump where it hangs: starts of -3.1 and 3.1 rad must not be averaged."""
    shown = experiment.demonstrations
    positions = shown.positions * torch.tensor([-1.0, 1.0, -1.0, 1.0]).double()
    mirrored = double_pendulum(replace(shown, positions=positions))
    expected = torch.tensor([2 * math.pi, 0.0]) - joint_trajectories(experiment)
    torch.testing.assert_close(joint_trajectories(mirrored), expected, check_dtype=False)


@pytest.mark.parametrize("hold", [1, 10])
def test_first_experience_and_later_starts_are_those_of_our_learner(
    experiment: Task, hold: int
) -> None:
    trainer = make_trainer(experiment, SEED, 2, False, lambda trial: None)
    batches = iter(trainer.collector)
    first, second = next(batches), next(batches)
    env = experiment.make_env(control_period=0.1 / hold, seed=SEED)
    motion = random_rollout(experiment, env, hold, SEED)
    torch.testing.assert_close(motion.torques, first["action"])
    torch.testing.assert_close(motion.states, states_of(first))
    still = random_torques(experiment.actions.half_range, 0.0, hold, torch.Generator())
    torch.testing.assert_close(execute(env, still, 1, hold).states[0], second["observation"][0])


@pytest.mark.usefixtures("quick")
def test_run_leaves_what_our_runs_leave(tmp_path: Path) -> None:
    told: list[DMPTrial] = []
    summary = short_run(out=tmp_path / "runs" / "seed_3", on_trial=told.append)
    [folder] = find_runs([tmp_path / "runs"])
    assert read_summary(folder) == summary == json.loads((folder / "summary.json").read_text())
    expected = {
        "experiment": "double_pendulum_dmp",
        "seed": 3,
        "command": COMMAND,
        "experience_s": pytest.approx(1.2),
        "saved_n_eval": 20,
        "stop_reason": "limit of trials",
        "trials": [asdict(trial) for trial in told],
    }
    assert {name: summary[name] for name in expected} == expected
    assert summary["settings"]["feedback_period"] == 0.01
    assert [trial.trial for trial in told] == [1, 2]
    assert [trial.experience_s for trial in told] == pytest.approx([0.4, 0.8])
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [field.name for field in fields(DMPTrial)]
    assert rows == [{name: str(value) for name, value in asdict(trial).items()} for trial in told]
    curve = success_over_experience([summary])
    assert curve.experience_s.tolist() == pytest.approx([0.4, 0.8, 1.2])


@pytest.mark.usefixtures("quick")
def test_same_seed_is_the_same_run_up_to_rounding(tmp_path: Path) -> None:
    folders = tmp_path / "a", tmp_path / "b"
    first, again = (short_run(out=out, feedback_period=0.1)["trials"] for out in folders)
    for trial, repeated in zip(first, again, strict=True):
        assert {**repeated, "gp_seconds": 0} == pytest.approx({**trial, "gp_seconds": 0}, rel=1e-4)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"feedback_period": 0.03}, f"feedback_period {DIVIDE}, got 0.03 s"),
        ({"feedback_period": 0.2}, f"feedback_period {DIVIDE}, got 0.2 s"),
        ({"feedback_period": -0.1}, f"feedback_period {DIVIDE}, got -0.1 s"),
        ({"feedback_period": 0.001}, "a whole number of 0.002 s time steps, got 0.001 s"),
        ({"seed": -1}, "seed .* got -1"),
        ({"trials": 0}, "trials .* got 0"),
        ({"trials": 1.5}, "trials .* got 1.5"),
        (
            {"name": "gym_pendulum"},
            "the baseline with movement primitives is for double_pendulum, got gym",
        ),
    ],
)
def test_what_is_impossible_is_refused_before_a_folder_is_made(
    experiment: Task, tmp_path: Path, changes: dict, complaint: str
) -> None:
    given = {"seed": 0, "trials": 1, "out": tmp_path / "run", "command": ""} | changes
    task = replace(experiment, name=given.pop("name", experiment.name))
    with pytest.raises(ValueError, match=complaint):
        run_dmp(task, **given)
    assert not (tmp_path / "run").exists()


def test_environment_is_asked_for_the_feedbacks_period(
    experiment: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    made: list[float] = []

    def make_env(control_period: float, **settings: object) -> DoublePendulumEnv:
        made.append(control_period)
        return DoublePendulumEnv(control_period=control_period, **settings)

    task = replace(short_experiment(), make_env=make_env)
    run_dmp(task, 0, 1, tmp_path, "", feedback_period=0.05)
    assert made == [0.05, 0.05]


@pytest.mark.slow
def test_swing_up_is_learned(experiment: Task, tmp_path: Path) -> None:
    summary = run_dmp(experiment, 10, 6, tmp_path, "")
    assert summary["trials"][0]["success_rate"] == 0
    assert summary["saved_success_rate"] >= 0.95
