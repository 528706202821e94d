"""Ours beside its peers: each run once, and numbers that are those of the runs, seed by seed."""

from __future__ import annotations

from pathlib import Path

import pytest

from reproduction.baselines.known_peers import named, trials_until
from reproduction.peers import COMPARISONS, TIMES, Comparison
from tests.helpers.summaries import leave_summary, trial
from torch_pmil.files import read_json

TUNING = Path(__file__).parents[2] / "results" / "paper" / "peers"
EACH = pytest.mark.parametrize("comparison", COMPARISONS.values(), ids=COMPARISONS)


def test_all_methods_learn_each_task_on_the_same_seeds(tmp_path: Path) -> None:
    """Ours on the double pendulum is learned once, for two comparisons."""
    each = COMPARISONS.values()
    runs = [run.out for one in each for run in one.needed_runs(tmp_path, quick=False)]
    methods = {(one.task, method.name) for one in each for method in one.methods}
    assert len(set(runs)) == 10 * len(methods) == len(runs) - 10


@EACH
def test_methods_have_names_and_labels_of_their_own_and_ours_is_the_first(
    comparison: Comparison,
) -> None:
    methods = comparison.methods
    assert methods[0].name == "ours"
    for attribute in ("name", "label"):
        assert len({getattr(method, attribute) for method in methods}) == len(methods)


def test_peers_have_the_settings_that_were_best_on_other_seeds() -> None:
    compared = 0
    for comparison in COMPARISONS.values():
        task = comparison.task
        for method in comparison.peers:
            tuning = TUNING / f"tuning_{method.peer.name}_{task}.json"
            if tuning.exists():
                assert read_json(tuning)["best"]["settings"] == method.settings, (task, method.name)
                compared += 1
    assert compared > 10


@pytest.mark.parametrize("name", ["double_pendulum", "pendubot", "biorob", "Sshape"])
def test_last_trial_learns_from_the_experience_that_is_compared(name: str) -> None:
    experiment = named(name)
    period, exploration = experiment.demonstrations.time_step, experiment.exploration
    explored, steps = exploration.rollouts * exploration.steps, experiment.horizon
    last = period * (explored + (trials_until(TIMES[-1], experiment) - 1) * steps)
    assert TIMES[-1] - period * steps < last <= TIMES[-1] + 1e-9


@EACH
def test_numbers_are_those_of_the_runs(comparison: Comparison, tmp_path: Path) -> None:
    """Ours succeeds from 20 s on, each other in half of the starts of even seeds.

    With more experience it is so at as many times as much.
    """
    runs = comparison.needed_runs(tmp_path, quick=False)
    methods = [method for method in comparison.methods for _ in range(10)]
    for method, run in zip(methods, runs, strict=True):
        seed = int(run.out.name.removeprefix("seed_"))
        rate = 1.0 if method.peer is None else 0.5 * (seed % 2 == 0)
        trials = [
            trial(method.factor * experience, rate * (experience >= 20), own_success=False)
            for experience in (10.0, 20.0, 50.0)
        ]
        numbers = {"experience_s": method.factor * 50.0, "saved_success_rate": rate}
        leave_summary(run.out, experiment="any", seed=seed, trials=trials, **numbers)
    found = comparison.results([run.out for run in runs], quick=False)
    headline = found.headline
    assert headline["seeds"] == 10 and headline["experience_to_95_ours"] == 20
    for method in comparison.methods:
        assert headline[f"success_12.5s_{method.name}"] == 0
        for time in ("25s", "50s"):
            rate = 1.0 if method.peer is None else 0.25
            assert headline[f"success_{time}_{method.name}"] == pytest.approx(rate)
    for method in comparison.peers:
        assert headline[f"experience_to_95_{method.name}"] is None
        ahead = found.details["ahead"][method.label]["25s"]
        assert ahead["difference"] == pytest.approx(0.75) and ahead["pairs"] == 10
        assert ahead["lower"] < 0.75 < ahead["upper"]
