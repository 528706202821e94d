"""Ours beside its peers: each run once, and numbers that are those of the runs, seed by seed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from reproduction.peers import TASKS, TIMES, methods, needed_runs, results, trials_until
from torch_pmil.experiments import load_experiment


def test_all_methods_learn_each_task_on_the_same_seeds(tmp_path: Path) -> None:
    runs = needed_runs(tmp_path, quick=False)
    each = sum(len(methods(task)) for task in TASKS)
    assert len({run.out for run in runs}) == len(runs) == 10 * each


@pytest.mark.parametrize("name", ["double_pendulum", "pendubot", "biorob"])
def test_last_trial_learns_from_the_experience_that_is_compared(name: str) -> None:
    experiment = load_experiment(name)
    period, exploration = experiment.demonstrations.time_step, experiment.exploration
    explored, steps = exploration.rollouts * exploration.steps, experiment.horizon
    last = period * (explored + (trials_until(TIMES[-1], experiment) - 1) * steps)
    assert TIMES[-1] - period * steps < last <= TIMES[-1] + 1e-9


def test_numbers_are_those_of_the_runs(tmp_path: Path) -> None:
    """Ours succeeds from 20 s on, each peer in half of the starts of even seeds."""
    runs = needed_runs(tmp_path, quick=False)
    for run in runs:
        seed, ours = int(run.out.name.removeprefix("seed_")), run.out.parent.name in TASKS
        rate = 1.0 if ours else 0.5 * (seed % 2 == 0)
        trials = [
            {
                "experience_s": experience,
                "success_rate": rate * (experience >= 20),
                "own_success": False,
            }
            for experience in (10.0, 20.0, 50.0)
        ]
        summary = {
            "wall_seconds": 1.0,
            "saved_trial": 1,
            "stop_reason": "limit of trials",
            "experiment": run.out.parent.name,
            "seed": seed,
            "experience_s": 50.0,
            "saved_success_rate": rate,
            "trials": trials,
        }
        run.out.mkdir(parents=True)
        (run.out / "summary.json").write_text(json.dumps(summary))
    found = results([run.out for run in runs], quick=False)
    headline = found.headline
    assert headline["success_12.5s_double_pendulum_ours"] == 0
    assert headline["success_25s_double_pendulum_ours"] == 1
    assert headline["experience_to_95_double_pendulum_ours"] == 20
    assert headline["success_50s_pendubot_gp_tracker"] == pytest.approx(0.25)
    assert headline["experience_to_95_pendubot_gp_tracker"] is None
    label = next(label for label, (name, _) in methods("pendubot").items() if name == "gp_tracker")
    ahead = found.details["pendubot"]["ahead"][label]["25s"]
    assert ahead["difference"] == pytest.approx(0.75) and ahead["pairs"] == 10
    assert ahead["lower"] < 0.75 < ahead["upper"]
    assert set(found.figures) == {f"peers_{task}" for task in TASKS}
