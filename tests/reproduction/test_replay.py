"""What is counted of replayed runs, and that a replay shows what the run knew."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from reproduction import failure_causes
from reproduction.failure_causes import CAUSES, ENDS, ReplayedTrial, cause_of, end_of
from reproduction.replay import GrowingModel, foresight, recording, replayed
from reproduction.replayed_runs import (
    Forecast,
    ReplayedRun,
    counts,
    coverage_ahead,
    reliability,
    tables,
)
from tests.helpers.replayed import RIGHT
from tests.helpers.short_run import STEPS, quick_fits, run, short_experiment
from torch_pmil.runs.summaries import wilson_interval

LUCK = "the own rollouts of two trials in a row succeeded"
NO_CAUSE = dict.fromkeys(CAUSES, 0)
STUCK = replace(RIGHT, complete=False, predicted_before=0.0, success_rate=0.0, spread_share=0.1)


def replayed_run(*trials: ReplayedTrial, **summary: object) -> ReplayedRun:
    plain = {"moved": 1.0, "saved_success_rate": 1.0, "predicted_saved": 1.0, "stop_reason": LUCK}
    numbered = [replace(trial, trial=number) for number, trial in enumerate(trials, 1)]
    return ReplayedRun("BioRob", plain | summary, numbered)


@pytest.mark.parametrize(
    ("cause", "trial", "moved"),
    [
        (None, replace(RIGHT, success_rate=0.95), 1.0),
        ("first motion too small", replace(RIGHT, trial=1), 0.2),
        ("criterion asks for more", RIGHT, 0.2),
        ("sure and wrong", replace(RIGHT, predicted_before=0.95), 1.0),
        ("chance of 20 starts", replace(RIGHT, predicted_before=0.95, success_rate=0.9), 1.0),
        ("tail not seen", replace(RIGHT, miss=2.1), 1.0),
        ("criterion asks for more", replace(RIGHT, miss=None), 1.0),
        ("model not right, and unsure", replace(RIGHT, success_rate=0.5), 1.0),
        ("search stopped early", STUCK, 1.0),
        ("model not right, and unsure", replace(STUCK, covered=0.7), 1.0),
        ("model not right, and unsure", replace(STUCK, followed=0.6), 1.0),
        ("model not right, and unsure", replace(STUCK, known=0.7), 1.0),
        ("model not right, and unsure", replace(STUCK, spread_share=0.6), 1.0),
        ("model not right, and unsure", replace(STUCK, followed=None, known=None), 1.0),
    ],
)
def test_each_failure_has_the_first_cause_that_applies(
    cause: str | None, trial: ReplayedTrial, moved: float
) -> None:
    assert cause_of(trial, moved) == cause
    assert cause is None or cause in CAUSES


def test_a_run_ends_learned_by_luck_or_at_the_limit() -> None:
    rates = (0.95, 0.1, LUCK), (0.9, 0.94, LUCK), (0.9, 0.95, LUCK), (0.9, 0.95, "limit of trials")
    assert tuple(end_of(*one) for one in rates) == ENDS


def test_trials_after_a_success_that_the_model_promises_to_repeat_are_not_needed() -> None:
    sure = replace(RIGHT, predicted_after=0.95)
    trials = [RIGHT, replace(sure, own_success=False), sure, RIGHT, sure]
    assert failure_causes.trials_not_needed(replayed_run(*trials).trials) == 2
    assert failure_causes.trials_not_needed(replayed_run(RIGHT, RIGHT).trials) == 0


def test_all_failures_are_counted_once_and_those_after_a_success_apart() -> None:
    learned, failed = replace(RIGHT, success_rate=1.0), replace(STUCK, own_success=False)
    runs = [
        replayed_run(failed, RIGHT, RIGHT, learned),
        replayed_run(failed, saved_success_rate=0.0, stop_reason="limit of trials"),
    ]
    assert counts(runs) == {
        "causes": NO_CAUSE | {"search stopped early": 2, "criterion asks for more": 2},
        "causes_after_success": NO_CAUSE | {"criterion asks for more": 1},
        "ends": dict.fromkeys(ENDS, 0) | {"learned": 1, "limit of trials": 1},
        "totals": {
            **{"runs": 2, "runs_not_learned": 1, "trials": 5, "trials_failed": 4},
            **{"runs_ended_by_luck": 0, "runs_ended_by_luck_known": 0},
            **{"trials_wrong_one_step": 0, "trials_not_needed": 0},
        },
    }
    vague, wrong = replace(STUCK, spread_share=0.9), replace(STUCK, covered=0.7)
    totals = counts([replayed_run(vague, wrong, replace(RIGHT, covered=0.7))])["totals"]
    assert totals["trials_wrong_one_step"] == 1


def test_reliability_pools_trials_of_like_predictions() -> None:
    low, high = reliability([Forecast(0.0, 0.1), Forecast(0.02, 0.3), Forecast(1.0, 1.0)])
    assert (low["trials"], low["predicted"], low["measured"]) == pytest.approx((2, 0.01, 0.2))
    assert low["lower"] == pytest.approx(wilson_interval(np.array(0.2), 2)[0])
    assert (high["trials"], high["predicted"], high["measured"]) == (1, 1.0, 1.0)
    assert high["lower"] == pytest.approx(1 / (1 + 1.96**2), abs=1e-4)


def test_coverage_is_told_up_to_the_first_success_and_after() -> None:
    before = replace(STUCK, own_success=False, coverage_ahead={"1": 0.5, "25": 0.1})
    found = coverage_ahead([replayed_run(before, replace(RIGHT, coverage_ahead={"1": 0.7}), RIGHT)])
    assert found["up_to_first_success"] == {"1": pytest.approx(0.6), "25": 0.1}
    assert found["after"] == {"1": 0.95}


def test_tables_have_each_task_and_all() -> None:
    hit, written = replayed_run(RIGHT), replace(replayed_run(RIGHT, RIGHT), task="handwriting")
    found = tables([hit, written])
    for numbers in ("counts", "coverage_ahead"):
        assert list(found[numbers]) == ["BioRob", "handwriting", "all"]
    assert [counted["totals"]["trials"] for counted in found["counts"].values()] == [1, 2, 3]


def test_replay_predicts_what_the_run_predicted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model before each rollout is that of the search: its loss is the very same."""
    quick_fits(monkeypatch)
    learned = run(tmp_path)
    found = replayed(tmp_path, short_experiment(), samples=10)
    assert [trial["loss"] for trial in found["replayed"]] == [t.loss for t in learned.trials]
    last = found["replayed"][learned.summary["saved_trial"] - 1]
    assert 0 <= found["predicted_saved"] <= 1 and last["samples"] == 10
    read = json.loads(json.dumps(found))["replayed"]
    assert [asdict(ReplayedTrial(**trial)) for trial in read] == found["replayed"]


def test_rollout_that_ended_early_is_judged_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    run(tmp_path)
    task = short_experiment()
    recorded, model = recording(tmp_path, task), GrowingModel(task)
    model.learn(recorded.explored.flatten())
    asked, whole = (task, recorded.policies(task)[0], model.dynamics), recorded.rollouts[0]
    up_to_there = foresight(*asked, whole, STEPS - 1)
    assert foresight(*asked, whole[:-1], STEPS - 1) == up_to_there
    ended_early = foresight(*asked, whole[:-1], STEPS)
    for name in ("followed", "known", "covered"):
        assert ended_early[name] == up_to_there[name]
