"""Learning from a robot's own rollouts alone: of any length, attended by an operator."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.helpers.attended import Attended, Operator
from tests.helpers.short_run import (
    COMMAND,
    PD_MOVEMENTS,
    SEED,
    STEPS,
    TRIALS,
    Stopped,
    stop,
    stop_in,
)
from tests.trainer.test_resume import assert_same_end, checkpoints_of
from torch_pmil.envs.operator import RobotError, RolloutDiscarded, RunStopped
from torch_pmil.runs.training import RunResult, make_trainer, train
from torch_pmil.trainer.trainer import PMILTrainer


def run(
    folder: Path, attended: Attended, resume: bool = False, trials: int = TRIALS, **changes: object
) -> RunResult:
    task, out = attended.experiment(**changes), {"progress_bar": False, "logger": "csv"}
    return train(task, SEED, trials, folder, COMMAND, resume=resume, **out)


def make(attended: Attended, trials: int = TRIALS, **changes: object) -> PMILTrainer:
    return make_trainer(attended.experiment(**changes), SEED, trials, False, lambda trial: None)


def trained(attended: Attended, trials: int = TRIALS, **changes: object) -> PMILTrainer:
    trainer = make(attended, trials, **changes)
    trainer.train()
    return trainer


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the operator let all rollouts run."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    run(folder, Attended())
    return folder


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, with a first motion of two rollouts."""
    folder = tmp_path_factory.mktemp("runs") / "moved"
    run(folder, Attended(), exploration=PD_MOVEMENTS)
    return folder


def rows(folder: Path) -> dict[str, str]:
    """The trials of metrics.csv and the rows of the logs, but for wall times."""
    paths = [*(folder / "logs").rglob("*.csv")]
    logged = {p.name: p.read_text() for p in paths if "seconds" not in p.name}
    steps = [line.split(",")[:3] for line in (folder / "metrics.csv").read_text().splitlines()]
    return logged | {"metrics.csv": str(steps)}


def test_robot_moves_for_its_own_rollouts_alone() -> None:
    attended = Attended()
    trainer = trained(attended)
    assert attended.operator.asked == TRIALS + 1
    measured = [(trial.success_rate, trial.n_eval, trial.steps) for trial in trainer.trials]
    assert measured == [(None, 0, STEPS)] * TRIALS
    assert len(trainer.experience) == (TRIALS + 1) * STEPS


def test_saved_policy_is_judged_by_its_own_rollout(whole: Path) -> None:
    summary = json.loads((whole / "summary.json").read_text())
    saved = summary["trials"][summary["saved_trial"] - 1]
    assert summary["saved_n_eval"] == 0
    assert summary["saved_success_rate"] == saved["own_success"]
    assert all(trial["success_rate"] is None for trial in summary["trials"])


def test_outcome_is_the_own_rollout_of_the_saved_policy(tmp_path: Path) -> None:
    result = run(tmp_path, Attended())
    outcome, number = result.outcomes[0], result.summary["saved_trial"]
    assert outcome.executed.shape == (1, STEPS + 1, 4)
    saved = result.trials[number - 1]
    assert outcome.errors.tolist() == [saved.own_error]
    again = result.policy.policy(result.policy.space.features(outcome.rollouts["observation"]))
    torch.testing.assert_close(outcome.rollouts["action"], again.detach().clamp(-1, 1))


def test_action_that_the_robot_changed_is_experience_as_it_was_sent() -> None:
    trainer = trained(Attended(), trials=1)
    assert trainer.experience.transitions["action"].abs().max() <= 1
    assert trainer.actor.policy.u_max.max() > 1


# rollouts that are cut short


def test_rollout_that_is_cut_short_is_a_failure_and_experience() -> None:
    trainer = trained(Attended(failing={3: 3}), tolerance=1e9, confirmations=2)
    ends = [(t.steps, t.own_success, t.cut_short) for t in trainer.trials]
    assert ends == [(4, True, ""), (2, False, "no reading in step 3"), (4, True, "")]
    assert trainer.trials[1].own_error == math.inf
    assert len(trainer.experience) == STEPS + 4 + 2 + 4
    assert trainer.experience.transitions["next", "observation"].isfinite().all()
    assert trainer.stop_reason == "limit of trials"


@pytest.mark.parametrize("steps", [2, STEPS])
def test_guard_ends_a_rollout_with_the_step_that_it_speaks_of(steps: int) -> None:
    """In the last step it makes a failure too."""

    def guard(states: Tensor) -> str:
        guard.calls += 1
        return "too far" if guard.calls == STEPS + steps else ""

    guard.calls = 0
    trainer = trained(Attended(guard=guard), trials=1, tolerance=1e9)
    trial = trainer.trials[0]
    assert (trial.steps, trial.cut_short) == (steps, "too far")
    assert (trial.own_success, trial.own_error) == (False, math.inf)
    assert len(trainer.experience) == STEPS + steps


def test_trials_are_counted_though_a_rollout_was_empty(tmp_path: Path) -> None:
    result = run(tmp_path, Attended(failing={2: 1, 4: 1}))
    assert [trial.steps for trial in result.trials] == [0, STEPS, 0]
    assert result.summary["stop_reason"] == "limit of trials"
    assert result.summary["saved_trial"] == 2


def test_longest_rollout_is_best_where_all_were_cut_short(tmp_path: Path) -> None:
    result = run(tmp_path, Attended(failing={2: 2, 3: 4, 4: 3}))
    assert result.summary["saved_trial"] == 2
    assert result.outcomes[0].executed.shape == (1, 4, 4)
    assert result.summary["saved_success_rate"] == 0
    first = result.summary["diagnosis"][0]
    assert first["cause"] == "rollouts cut short" and "3 of 3" in first["message"]


def test_collector_may_make_shorter_rollouts() -> None:
    trainer = make(Attended(), 2, tolerance=1e9)
    trainer.register_op(
        "post_steps_log", lambda batch: setattr(trainer.collector, "steps", 2 - len(trainer.trials))
    )
    trainer.train()
    ends = [(trial.steps, trial.own_success) for trial in trainer.trials]
    assert ends == [(2, False), (1, False)]


def test_first_motion_that_gives_no_model_is_an_error_and_not_kept(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"must give 2 transitions at least, got 1: no reading"):
        run(tmp_path, Attended(failing={1: 2}))
    assert not checkpoints_of(tmp_path)
    run(tmp_path, Attended(), resume=True)


def test_policies_that_made_no_step_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no policy made a step on the robot: no reading"):
        run(tmp_path, Attended(failing={number: 1 for number in range(2, TRIALS + 2)}))


# what an operator asks for


@pytest.mark.parametrize("keys", ["d", " d", "  d", "   d", "d d  d", " dd"])
def test_run_of_which_rollouts_were_discarded_ends_as_one_that_never_had_them(
    keys: str, whole: Path, tmp_path: Path
) -> None:
    run(tmp_path / "run", Attended(Operator([key.strip() for key in keys])))
    assert_same_end(tmp_path / "run", whole)
    assert rows(tmp_path / "run") == rows(whole)


@pytest.mark.parametrize("keys", [("", "d"), ("", "", "d"), ("", "", "", "d")], ids="-".join)
def test_rollout_of_the_first_motion_may_be_discarded_too(
    keys: Sequence[str], moved: Path, tmp_path: Path
) -> None:
    operator = Operator(keys)
    run(tmp_path / "run", Attended(operator), exploration=PD_MOVEMENTS)
    assert_same_end(tmp_path / "run", moved)
    assert operator.asked == 2 + TRIALS + 2  # the key, and one rollout once more


def test_no_more_is_discarded_than_checkpoints_are_left(whole: Path, tmp_path: Path) -> None:
    with pytest.warns(RuntimeWarning, match="the rollout stays"):
        run(tmp_path / "run", Attended(Operator(("", "", "", "d", "d"))))
    assert_same_end(tmp_path / "run", whole)


@pytest.mark.parametrize(("key", "kind"), [("q", RunStopped), ("off", RobotError)])
@pytest.mark.parametrize("before", [0, 1, 2])
def test_run_that_the_operator_or_the_robot_ended_goes_on(
    key: str, kind: type[Exception], before: int, whole: Path, tmp_path: Path
) -> None:
    with pytest.raises(kind):
        run(tmp_path / "run", Attended(Operator([""] * before + [key])))
    run(tmp_path / "run", Attended(), resume=True)
    assert_same_end(tmp_path / "run", whole)


def test_rollout_may_be_discarded_at_once_after_a_resumption(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(RunStopped):
        run(tmp_path / "run", Attended(Operator(("", "", "q"))))
    run(tmp_path / "run", Attended(Operator(("d",))), resume=True)
    assert_same_end(tmp_path / "run", whole)


def test_discarded_rollout_stays_away_though_the_run_stops_at_once(
    whole: Path, tmp_path: Path
) -> None:
    operator = Operator(("", "", "d", "q"))
    with pytest.raises(RunStopped):
        run(tmp_path / "run", Attended(operator))
    run(tmp_path / "run", Attended(operator), resume=True)
    assert_same_end(tmp_path / "run", whole)
    assert operator.asked == 2 + 2 + TRIALS  # with the rollout that was discarded once more


def test_trainer_alone_leaves_discarding_to_its_caller() -> None:
    with pytest.raises(RolloutDiscarded):
        trained(Attended(Operator(("", "d"))))


# power losses


@pytest.mark.parametrize("count", [3, STEPS + 2, 2 * STEPS + 1])
def test_rollout_in_whose_midst_a_run_stopped_is_all_that_it_loses(
    count: int, moved: Path, tmp_path: Path
) -> None:
    operator = Operator()
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
        stop_in(patch, "collection", 7 + count, stop)
        run(tmp_path / "run", Attended(operator), exploration=PD_MOVEMENTS)
    run(tmp_path / "run", Attended(operator), resume=True, exploration=PD_MOVEMENTS)
    assert_same_end(tmp_path / "run", moved)
    assert operator.asked == 2 + TRIALS + 1


def test_why_a_rollout_was_cut_short_outlives_a_stop(tmp_path: Path) -> None:
    run(tmp_path / "whole", Attended(failing={2: 3}))
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
        stop_in(patch, "fit", 5, stop)
        run(tmp_path / "run", Attended(failing={2: 3}))
    result = run(tmp_path / "run", Attended(), resume=True)
    assert result.trials[0].cut_short == "no reading in step 3"
    assert_same_end(tmp_path / "run", tmp_path / "whole")
