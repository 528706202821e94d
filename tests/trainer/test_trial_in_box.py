"""Learning within limits: what is refused, cut short, stopped and recorded."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch

from tests.helpers.short_run import COMMAND, SEED, STEPS, short_experiment
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.runs.training import make_trainer, train
from torch_pmil.search.admission import Admission
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Trial

WIDE = {"dq1": (-1e6, 1e6)}
TIGHT = {"dq2": (-1.5, 1.5)}  # rad/s, reached in the first steps of a swing-up


def trained(**changes: object) -> PMILTrainer:
    trainer = make_trainer(short_experiment(**changes), SEED, 2, False, lambda trial: None)
    trainer.train()
    return trainer


def ran(trial: Trial) -> tuple[int, str]:
    return trial.steps, trial.cut_short


@pytest.mark.parametrize(("box", "leaving"), [(WIDE, 0.0), (None, None)])
def test_wide_limits_and_none_leave_the_trials_as_they_are(
    box: dict | None, leaving: float | None
) -> None:
    trials = trained(box=box).trials
    assert [ran(trial) for trial in trials] == [(STEPS, "")] * 2
    assert [(trial.leaving_probability, trial.refused) for trial in trials] == [(leaving, 0)] * 2


def test_policy_that_is_likely_to_leave_runs_for_its_first_steps_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A rollout that is cut short is a failure, and experience."""
    monkeypatch.setattr(
        "torch_pmil.trainer.trainer.admit",
        lambda loss, initial, box, settings, result, *rest: Admission(result, 0.3, 3, steps=2),
    )
    trainer = trained(box=WIDE)
    for trial in trainer.trials:
        assert ran(trial) == (2, "it was likely to leave the box")
        assert (trial.leaving_probability, trial.refused) == (0.3, 3)
        assert (trial.own_error, trial.own_success) == (math.inf, False)
    assert len(trainer.experience) == STEPS + 2 * 2


def test_guard_stops_the_first_motion_of_a_robot_that_leaves() -> None:
    """It moves by itself from a start with speed; two transitions are left to learn from."""
    with pytest.raises(
        RuntimeError, match=r"transitions at least, got 1: dq2 = .* left its limits"
    ):
        trained(box={"dq2": (-0.05, 0.05)})


def test_training_ends_where_no_policy_may_do_a_step() -> None:
    """Its one line says so; there is no best policy then."""
    trainer = trained(box=TIGHT, leaving_threshold=1e-9)
    reason = "no policy was admitted: its first step may already leave the box"
    assert trainer.stop_reason == reason
    assert not trainer.trials
    with pytest.raises(RuntimeError) as refused:
        trainer.best_policy()
    assert str(refused.value) == f"a policy must have run to be the best, got none: {reason}"


def test_summary_tells_the_limits_and_each_trial_its_probability(tmp_path: Path) -> None:
    experiment = short_experiment(box=WIDE, leaving_threshold=0.1)
    train(experiment, SEED, 1, tmp_path / "run", COMMAND, progress_bar=False)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    box = {"limits": {"dq1": [-1e6, 1e6]}, "threshold": 0.1}
    assert summary["settings"]["state_box"] == box
    assert [(t["leaving_probability"], t["refused"]) for t in summary["trials"]] == [(0.0, 0)]


def test_run_within_limits_resumes_with_the_same_limits_alone(tmp_path: Path) -> None:
    out = tmp_path / "run"
    train(short_experiment(box=WIDE), SEED, 1, out, COMMAND, progress_bar=False)
    with pytest.raises(ValueError, match="has state_box = "):
        train(short_experiment(box=TIGHT), SEED, 2, out, COMMAND, progress_bar=False, resume=True)


def test_limits_must_hold_the_start() -> None:
    with pytest.raises(ValueError) as refused:
        short_experiment(box={"q1": (-1.0, 1.0)})
    line = "box must hold the mean of initial, but q1 = 3.14 rad left its limits of -1 to 1 rad"
    assert str(refused.value) == line


def test_robot_that_is_measured_in_turn_is_guarded_too() -> None:
    """A rollout that leaves does not count as a success."""
    experiment = short_experiment(box={"dq2": (-0.05, 0.05)}, evaluated=False)
    policy = experiment.make_policy(torch.Generator().manual_seed(0))
    errors = experiment.errors(StatePolicy(policy, experiment.space, 0.1), starts=5, seed=100)
    assert errors.tolist() == [math.inf] * 5
