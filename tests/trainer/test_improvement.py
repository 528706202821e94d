"""A run that imitates, and then improves: when it changes, when it ends, and what it saves."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from tests.helpers.short_run import SEED, run, short_experiment, stalling, stopped_run
from tests.trainer.test_resume import assert_same_end
from torch_pmil import SaturatingCost
from torch_pmil.runs.training import make_trainer
from torch_pmil.search.promise import SAMPLES, PredictedSuccess, Promise
from torch_pmil.search.sample_search import expected_cost
from torch_pmil.search.trial_search import TrialSearch
from torch_pmil.tasks.improving_task import ImprovingTask, improving
from torch_pmil.tasks.task import Task
from torch_pmil.trainer import choice, trainer
from torch_pmil.trainer.choice import SEED as SEED_OF_COSTS, SETTLED, best_candidate, is_settled
from torch_pmil.trainer.ending import AGAIN, LIMIT, Ending
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Candidate, Trial

COST = SaturatingCost(target={"x2": 0.0, "y2": -1.0}, width=0.1)  # it hangs
ENDLESS = 1e9  # tolerance


def error(states: Tensor) -> Tensor:
    return states[..., 0, 0]


def trial(success: bool, promised: float = 0.99) -> SimpleNamespace:
    rate = promised if success else None
    return SimpleNamespace(own_success=success, promised_success_rate=rate, success_rate=None)


IMITATED = [trial(False), trial(True)]


@pytest.mark.parametrize(
    ("own", "ends"),
    [
        ([], False),
        ([trial(True)], True),
        ([trial(True), trial(False)], False),
        ([trial(True, 0.5)] * AGAIN, False),  # own successes alone are not enough
    ],
)
def test_improvement_ends_as_a_run_of_its_own(own: Sequence[Trial], ends: bool) -> None:
    ending = Ending(9, 1, Promise(0.95, error, 0.1))
    assert ending.imitated([*IMITATED, *own]) == 2
    assert bool(ending.improved([*IMITATED, *own])) == ends


def test_successes_of_imitation_confirm_no_improvement() -> None:
    ending = Ending(9, 2)
    imitated = [trial(True), trial(True)]
    assert ending.improved([*imitated, trial(False), trial(True)]) == ""
    assert ending.improved([*imitated, trial(True), trial(True)])


def test_improvement_ends_at_the_limit_and_lacks_nothing() -> None:
    ending = Ending(4, 1, Promise(0.95, error, 0.1))
    trials = [*IMITATED, trial(True), trial(False)]
    assert ending.improved(trials) == LIMIT and ending.reason(trials) == LIMIT
    assert ending.unmet(trials) == ""
    assert ending.imitated([trial(False)] * 4) == 0


@cache
def short() -> ImprovingTask:
    """The first steps of the double pendulum, whose rollouts are all successes, two to confirm."""
    task = stalling(tolerance=ENDLESS, confirmations=2)
    return improving(task, COST, imitation_weight=0.1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing stopped, of two trials of imitation and two of improvement at least."""
    folder = tmp_path_factory.mktemp("improving") / "whole"
    run(folder, task=short(), trials=6)
    return folder


def test_run_improves_what_it_imitated(whole: Path) -> None:
    summary = json.loads((whole / "summary.json").read_text())
    assert len(summary["trials"]) >= 4
    settings = summary["settings"]
    assert settings["cost"] == COST.said and settings["imitation_weight"] == 0.1


@pytest.mark.parametrize(
    ("phase", "count"), [("search", 1), ("search", 6), ("search", 14), ("collection", 19)]
)
def test_stopped_run_goes_on_to_the_same_end(
    phase: str, count: int, whole: Path, tmp_path: Path
) -> None:
    """It is stopped before and after the change."""
    folder = stopped_run(tmp_path / "run", phase, count, task=short(), trials=6)
    run(folder, resume=True, task=short(), trials=6)
    assert_same_end(folder, whole)


def test_run_that_begins_with_another_imitates_first(whole: Path, tmp_path: Path) -> None:
    lines: list[str] = []
    result = run(tmp_path / "run", resume=whole, task=short(), trials=3, announce=lines.append)
    assert len(result.trials) == 3
    assert len(lines) == 1 and lines[0].endswith(
        "from now on it improves by the cost and 0.1 times the KL"
    )


def test_imitation_is_that_of_the_task_without_a_cost(whole: Path, tmp_path: Path) -> None:
    plain = run(tmp_path / "run", task=stalling(tolerance=ENDLESS, confirmations=2), trials=6)
    trials = json.loads((whole / "summary.json").read_text())["trials"]
    assert len(plain.trials) == 2
    for ours, expected in zip(trials, plain.summary["trials"], strict=False):
        for times in ("gp_seconds", "search_seconds"):
            del ours[times], expected[times]
        assert ours == expected


def test_no_improvement_begins_at_the_limit(tmp_path: Path) -> None:
    lines: list[str] = []
    result = run(tmp_path / "run", task=short(), trials=2, announce=lines.append)
    assert len(result.trials) == 2 and not lines
    assert result.summary["stop_reason"] != LIMIT


@pytest.mark.parametrize("settled", [True, False])
def test_run_goes_on_while_the_cost_falls(
    settled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trainer, "is_settled", lambda *judged: settled)
    result = run(tmp_path / "run", task=short(), trials=5)
    assert len(result.trials) == (4 if settled else 5)


def test_losses_of_both_phases_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    least: list[float] = []
    search = TrialSearch.run
    monkeypatch.setattr(
        TrialSearch,
        "run",
        lambda self, *given: (least.append(self._least), search(self, *given))[1],
    )
    trainer_of(short())
    assert least[0] == math.inf  # of a random policy
    assert [value > 1e300 for value in least[:4]] == [True, False, True, False]
    assert least[2] < math.inf


def trainer_of(task: Task) -> PMILTrainer:
    made = make_trainer(task, SEED, 4, False, lambda trial: None)
    made.train()
    return made


def chosen(made: PMILTrainer, *candidates: tuple[Candidate, float]) -> int:
    """The trial of the best of these, whose measured rates are given."""
    trials = [
        replace(made.trials[0], trial=number, success_rate=rate, n_eval=20)
        for number, (_, rate) in enumerate(candidates, start=1)
    ]
    judged = made.loss_module, made.initial, made.promise, made.tolerance
    return best_candidate([each for each, _ in candidates], trials, *judged).trial


def test_policy_of_least_expected_cost_is_saved_among_those_that_keep_the_promise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = trainer_of(short())
    loss, initial = made.loss_module, made.initial
    first = {name: value.clone() for name, value in loss.actor_network.state_dict().items()}
    second = {**first, "weights": first["weights"] + 1.0}
    costs = []
    for parameters in (first, second):
        loss.actor_network.load_state_dict(parameters)
        costs.append(expected_cost(loss.cost, initial, SEED_OF_COSTS))
    cheap, dear = (first, second) if costs[0] < costs[1] else (second, first)
    settled = [
        is_settled([Candidate(1, before, 0.0), Candidate(2, newest, 0.0)], loss, initial)
        for before, newest in ((dear, cheap), (cheap, dear), (cheap, cheap))
    ]
    assert settled == [False, True, True]
    assert min(costs) < SETTLED * max(costs)
    with monkeypatch.context() as patched:  # costs may be negative
        left = iter([-10.0, -10.0, -10.0, -11.0])
        patched.setattr(choice, "expected_cost", lambda *_: next(left))
        two = [Candidate(1, first, 0.0), Candidate(2, first, 0.0)]
        assert [is_settled(two, loss, initial) for _ in range(2)] == [True, False]
    one, two = Candidate(1, dear, 0.0), Candidate(2, cheap, 0.0)
    assert chosen(made, (one, 1.0), (two, 0.95)) == 2
    assert chosen(made, (one, 1.0), (two, 0.5)) == 1  # it fails too often
    assert chosen(made, (one, 1.0), (replace(two, own_error=2 * ENDLESS), 1.0)) == 1

    def predicted(*judged: object) -> PredictedSuccess:
        unsure = torch.equal(loss.actor_network.weights, cheap["weights"])
        return PredictedSuccess(450 if unsure else SAMPLES)

    monkeypatch.setattr(Promise, "predicted", predicted)
    assert chosen(made, (one, 1.0), (two, 1.0)) == 1
    loss.improve(False)
    assert chosen(made, (one, 1.0), (two, 0.95)) == 1


def test_settings_of_a_task_without_a_cost_are_as_they_were() -> None:
    plain, ours = short_experiment(), improving(short_experiment(), COST)
    added = {"cost": COST.said, "imitation_weight": 1.0}
    assert ours.settings == plain.settings | added
    assert not added.keys() & plain.settings.keys()
