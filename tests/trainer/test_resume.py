"""A run that was stopped anywhere ends as one that was not, bit for bit."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from reproduction.robustness import with_noise
from tests.helpers.short_run import (
    COMMAND,
    PD_MOVEMENTS,
    SEED,
    STEPS,
    TRIALS,
    Stopped,
    quick_fits,
    run,
    short_experiment,
    stop,
    stop_in,
    stopped_run,
)
from torch_pmil.runs.run_folder import FinishedRunError, UnfinishedRunError
from torch_pmil.runs.training import train
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.trainer.checkpoints import rotation_in, saved_checkpoints
from torch_pmil.trainer.collector import RolloutCollector

ROOT = Path(__file__).parents[2]
TIMES = {"date", "wall_seconds", "commit"}, {"gp_seconds", "search_seconds"}  # of a run, of a trial
STOPS = (
    ("collection", 2),  # no checkpoint yet
    ("collection", STEPS + 2),
    ("fit", 2),
    ("fit", 6),
    ("search", 1),
    ("search", 4),
    ("search", 8),
    ("evaluation", STEPS + 2),
    ("writing", 3),  # the first checkpoint
    ("writing", 60),
    ("renaming", 1),
    ("renaming", 3),
    ("fit", 4 * TRIALS + 1),  # all trials are done, the best policy is chosen
)
FEW = (STOPS[1], STOPS[6], STOPS[7], STOPS[-1])  # one of each phase that writes no file


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing stopped."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    run(folder)
    return folder


@pytest.fixture(scope="module")
def stopped_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stopped_run(tmp_path_factory.mktemp("runs") / "stopped", "search", 5)


@pytest.fixture
def stopped(stopped_once: Path, tmp_path: Path) -> Path:
    """A run that was stopped in a search after the first trial."""
    return shutil.copytree(stopped_once, tmp_path / "stopped")


def tensors(path: Path) -> dict[str, Tensor]:
    content = torch.load(path, weights_only=True)
    return content.get("parameters", content)


def numbers(folder: Path) -> dict:
    summary = json.loads((folder / "summary.json").read_text())
    trials = [
        {key: value for key, value in trial.items() if key not in TIMES[1]}
        for trial in summary["trials"]
    ]
    return {key: value for key, value in summary.items() if key not in TIMES[0]} | {
        "trials": trials
    }


def assert_same_end(folder: Path, whole: Path) -> None:
    for name in ("policy.pt", "dynamics.pt"):
        ours, expected = tensors(folder / name), tensors(whole / name)
        assert ours.keys() == expected.keys()
        assert all(torch.equal(ours[key], expected[key]) for key in ours)
    assert numbers(folder) == numbers(whole)


@pytest.mark.parametrize(("phase", "count"), FEW, ids=str)
def test_stopped_run_ends_as_one_that_was_not_stopped(
    phase: str, count: int, whole: Path, tmp_path: Path
) -> None:
    folder = stopped_run(tmp_path / "run", phase, count)
    run(folder, resume=True)
    assert_same_end(folder, whole)


@pytest.mark.slow
@pytest.mark.parametrize(("phase", "count"), STOPS, ids=str)
def test_killed_run_ends_as_one_that_was_not_killed(
    phase: str, count: int, whole: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "tests.helpers.short_run", str(folder)]
    with subprocess.Popen(
        [*command, phase, str(count)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert "stopped\n" in process.stdout
        process.kill()
    folder.mkdir(exist_ok=True)
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    assert_same_end(folder, whole)


@pytest.mark.robot
def test_run_of_the_baseline_goes_on_too(tmp_path: Path) -> None:
    pilco = {"name": "double_pendulum_pilco"}
    run(tmp_path / "whole", **pilco)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
        stop_in(patch, "search", 5, stop)
        run(tmp_path / "stopped", **pilco)
    run(tmp_path / "stopped", resume=True, **pilco)
    assert_same_end(tmp_path / "stopped", tmp_path / "whole")


@pytest.mark.robot
def test_run_with_noisy_sensors_goes_on_with_the_same_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noisy = with_noise(0.02)
    monkeypatch.setitem(EXPERIMENTS, "double_pendulum", lambda demonstrations: noisy)
    run(tmp_path / "whole")
    run(stopped_run(tmp_path / "stopped", "search", 5), resume=True)
    assert_same_end(tmp_path / "stopped", tmp_path / "whole")


@pytest.mark.robot
@pytest.mark.parametrize(("phase", "count"), [("fit", 1), ("search", 5)], ids=str)
def test_run_with_an_exploration_of_its_own_goes_on_too(
    phase: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = replace(load_experiment("double_pendulum"), pd_movements=PD_MOVEMENTS)
    monkeypatch.setitem(EXPERIMENTS, "double_pendulum", lambda demonstrations: experiment)
    run(tmp_path / "whole")
    assert numbers(tmp_path / "whole")["experience_s"] == pytest.approx(
        0.1 * (2 * 7 + TRIALS * STEPS)
    )
    run(stopped_run(tmp_path / "stopped", phase, count), resume=True)
    assert_same_end(tmp_path / "stopped", tmp_path / "whole")


@pytest.mark.parametrize(("before", "after"), [(None, "csv"), ("csv", None)])
def test_run_goes_on_with_another_logger(
    before: str | None, after: str | None, whole: Path, tmp_path: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
        stop_in(patch, "search", 5, stop)
        run(tmp_path / "run", logger=before)
    run(tmp_path / "run", resume=True, logger=after)
    assert_same_end(tmp_path / "run", whole)
    assert after is None or any((tmp_path / "run" / "logs").rglob("*.csv"))


def test_run_may_be_stopped_again_and_again(whole: Path, stopped: Path) -> None:
    for phase, count in (("fit", 1), ("evaluation", 1), ("renaming", 1)):
        with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
            stop_in(patch, phase, count, stop)
            run(stopped, resume=True)
    run(stopped, resume=True)
    assert_same_end(stopped, whole)


def test_finished_run_comes_to_the_same_end_again(whole: Path, tmp_path: Path) -> None:
    run(tmp_path / "run")
    run(tmp_path / "run", resume=True)
    assert_same_end(tmp_path / "run", whole)


def test_finished_run_goes_on_where_more_trials_are_allowed(whole: Path, tmp_path: Path) -> None:
    run(tmp_path / "run", trials=TRIALS - 1)
    run(tmp_path / "run", resume=True)
    assert_same_end(tmp_path / "run", whole)


def test_resuming_where_nothing_was_saved_is_a_new_run(whole: Path, tmp_path: Path) -> None:
    run(tmp_path / "run", resume=True)
    assert_same_end(tmp_path / "run", whole)


@pytest.mark.parametrize(
    "flaw",
    [
        "cut short",
        "one byte",
        *(pytest.param(flaw, marks=pytest.mark.slow) for flaw in ("empty", "not an archive")),
    ],
)
def test_damaged_newest_checkpoint_falls_back_to_the_one_before(
    flaw: str, whole: Path, stopped: Path
) -> None:
    newest = saved_checkpoints(rotation_in(stopped / "checkpoints"))[0]
    content = bytearray(newest.read_bytes())
    place = content.index(b"state.json") + 200
    content[place] ^= 1
    newest.write_bytes(
        {
            "cut short": content[: len(content) // 2],
            "one byte": content,
            "empty": b"",
            "not an archive": b"checkpoint" * 100,
        }[flaw]
    )
    with pytest.warns(
        RuntimeWarning, match=f"{newest.name} is damaged .*: the one before it is taken"
    ):
        run(stopped, resume=True)
    assert_same_end(stopped, whole)


def test_all_checkpoints_damaged_is_said(stopped: Path) -> None:
    for path in saved_checkpoints(rotation_in(stopped / "checkpoints")):
        path.write_bytes(b"")
    with (
        pytest.warns(RuntimeWarning),
        pytest.raises(RuntimeError, match=r"all checkpoints in .* are damaged"),
    ):
        run(stopped, resume=True)


def test_stopped_run_is_not_overwritten(stopped: Path) -> None:
    with pytest.raises(
        UnfinishedRunError, match=f"{stopped} holds a run that was stopped: go on with resume=true"
    ):
        run(stopped)
    assert saved_checkpoints(rotation_in(stopped / "checkpoints"))


def test_finished_run_that_was_stopped_as_it_went_on_is_not_overwritten(tmp_path: Path) -> None:
    run(tmp_path, trials=TRIALS - 1)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
        stop_in(patch, "search", 1, stop)
        run(tmp_path, resume=True)
    with pytest.raises(UnfinishedRunError):
        run(tmp_path)


def test_finished_run_is_replaced_only_if_told(whole: Path, tmp_path: Path) -> None:
    run(tmp_path / "run", seed=SEED + 1)
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    with pytest.raises(FinishedRunError, match="a run that has ended: overwrite=true replaces it"):
        run(tmp_path / "run")
    assert before == {
        path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()
    }
    run(tmp_path / "run", overwrite=True)
    assert_same_end(tmp_path / "run", whole)


def test_replaced_run_that_is_stopped_leaves_nothing_of_the_old_one(
    whole: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(whole, tmp_path / "run")
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stopped):
        stop_in(patch, "search", 1, stop)
        run(folder, overwrite=True)
    assert {path.name for path in folder.iterdir()} == {
        "run.json",
        "settings.yaml",
        "metrics.csv",
        "checkpoints",
        "figures",
    }


def test_replacing_and_going_on_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="give one of the two"):
        run(tmp_path / "run", resume=True, overwrite=True)
    assert not (tmp_path / "run").exists()


def test_another_run_is_not_gone_on_with(stopped: Path) -> None:
    with pytest.raises(ValueError, match=f"has seed = {SEED}, got {SEED + 1}: it cannot go on so"):
        run(stopped, resume=True, seed=SEED + 1)


def test_robot_moves_as_often_as_in_a_run_without_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rollout that was collected before the stop is learned from, and not collected again."""
    rollouts: list[int] = []
    original = RolloutCollector.rollout
    monkeypatch.setattr(
        RolloutCollector, "rollout", lambda self: rollouts.append(1) or original(self)
    )
    run(stopped_run(tmp_path / "run", "search", 5), resume=True)
    assert len(rollouts) == TRIALS + 1


def test_run_with_plans_goes_on_from_its_last_plan(tmp_path: Path) -> None:
    states = load_experiment("double_pendulum").demonstrated_states.unflatten(0, (5, -1))
    experiment = short_experiment(
        demonstrated_states=states[:, : STEPS + 1].flatten(0, 1), plan_weight=1.0
    )

    def learn(folder: Path, resume: bool = False) -> None:
        train(experiment, SEED, TRIALS, folder, COMMAND, progress_bar=False, resume=resume)

    learn(tmp_path / "whole")
    with pytest.MonkeyPatch.context() as patch:
        stop_in(patch, "collection", 3 * STEPS + 2, stop)  # in the second own rollout
        with pytest.raises(Stopped):
            learn(tmp_path / "stopped")
    learn(tmp_path / "stopped", resume=True)
    assert_same_end(tmp_path / "stopped", tmp_path / "whole")
