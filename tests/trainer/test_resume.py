"""A run that was stopped anywhere ends as one that was not, bit for bit."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.helpers.short_run import (
    PD_MOVEMENTS,
    SEED,
    STEPS,
    TRIALS,
    run,
    stalling,
    stopped_run,
)
from torch_pmil.runs.run_folder import FinishedRunError, UnfinishedRunError
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.checkpoints import rotation_in, saved_checkpoints
from torch_pmil.trainer.collector import RolloutCollector

ROOT = Path(__file__).parents[2]
# of a run, of a trial
TIMES = {"date", "wall_seconds", "cpu_seconds", "commit"}, {"gp_seconds", "search_seconds"}
STOPS = (
    ("collection", 2),  # no checkpoint yet
    ("collection", STEPS + 2),
    ("fit", 2),
    ("fit", 3),
    ("search", 1),
    ("search", 4),
    ("search", 8),
    ("evaluation", STEPS + 2),
    ("writing", 3),  # the first checkpoint
    ("writing", 60),
    ("renaming", 1),
    ("renaming", 3),
    ("fit", 2 * TRIALS + 1),  # all trials are done, the best policy is chosen
)
START_TRUSTED = 1.0  # of what a cost doubts: the start is surer, the first steps are not
FEW = (STOPS[1], STOPS[6], STOPS[7], STOPS[-1])  # one of each phase that writes no file


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


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def checkpoints_of(folder: Path) -> list[Path]:
    """The newest first."""
    return saved_checkpoints(rotation_in(folder / "checkpoints"))


def numbers(folder: Path) -> dict:
    """The summary without its times."""
    summary = json.loads((folder / "summary.json").read_text())
    for holder, times in ((summary, TIMES[0]), *((trial, TIMES[1]) for trial in summary["trials"])):
        for name in times:
            holder.pop(name)
    return summary


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


def noisy() -> Task:
    """The states that are seen and learned from have noise."""
    noise, plain = torch.tensor([0.02, 0.2, 0.02, 0.2], dtype=torch.float64), stalling()
    env = partial(plain.make_env, observation_std=noise.tolist())
    return replace(plain, make_env=env, initial=plain.initial.add_noise(noise**2))


MAKERS: dict[str, Callable[[], Task]] = {
    "PILCO": partial(stalling, "double_pendulum_pilco", START_TRUSTED),
    "noisy sensors": noisy,
    "PD movements": partial(stalling, exploration=PD_MOVEMENTS),
}


@pytest.mark.robot
@pytest.mark.parametrize(
    ("task", "phase", "count"),
    [*((name, "search", 5) for name in MAKERS), ("PD movements", "fit", 1)],
)
def test_run_of_another_task_goes_on_too(task: str, phase: str, count: int, tmp_path: Path) -> None:
    make = MAKERS[task]
    whole = run(tmp_path / "whole", task=make())
    explored = whole.summary["settings"]["exploration"]
    moved = 0.1 * (explored["rollouts"] * explored["steps"] + TRIALS * STEPS)
    assert whole.summary["experience_s"] == pytest.approx(moved)
    run(stopped_run(tmp_path / "stopped", phase, count, make()), resume=True, task=make())
    assert_same_end(tmp_path / "stopped", tmp_path / "whole")


@pytest.mark.parametrize(("before", "after"), [(None, "csv"), ("csv", None)])
def test_run_goes_on_with_another_logger(
    before: str | None, after: str | None, whole: Path, tmp_path: Path
) -> None:
    stopped_run(tmp_path / "run", "search", 5, logger=before)
    run(tmp_path / "run", resume=True, logger=after)
    assert_same_end(tmp_path / "run", whole)
    assert after is None or any((tmp_path / "run" / "logs").rglob("*.csv"))


def test_run_may_be_stopped_again_and_again(whole: Path, stopped: Path) -> None:
    for phase in ("fit", "evaluation", "renaming"):
        stopped_run(stopped, phase, 1, resume=True)
    run(stopped, resume=True)
    assert_same_end(stopped, whole)


@pytest.mark.parametrize("trials", [0, TRIALS - 1, TRIALS])
def test_run_that_never_began_or_had_ended_comes_to_the_same_end(
    trials: int, whole: Path, tmp_path: Path
) -> None:
    if trials:
        run(tmp_path / "run", trials=trials)
    run(tmp_path / "run", resume=True)
    assert_same_end(tmp_path / "run", whole)


def with_another_byte(content: bytes) -> bytes:
    place = content.index(b"state.json") + 200
    return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]


FLAWS: dict[str, Callable[[bytes], bytes]] = {
    "cut short": lambda content: content[: len(content) // 2],
    "one byte": with_another_byte,
    "empty": lambda content: b"",
    "not an archive": lambda content: b"checkpoint" * 100,
}
SLOW_FLAWS = [pytest.param(flaw, marks=pytest.mark.slow) for flaw in ("empty", "not an archive")]


@pytest.mark.parametrize("flaw", ["cut short", "one byte", *SLOW_FLAWS])
def test_damaged_newest_checkpoint_falls_back_to_the_one_before(
    flaw: str, whole: Path, stopped: Path
) -> None:
    newest = checkpoints_of(stopped)[0]
    newest.write_bytes(FLAWS[flaw](newest.read_bytes()))
    with pytest.warns(RuntimeWarning, match=f"{newest.name} is damaged .*: the one before it is t"):
        run(stopped, resume=True)
    assert_same_end(stopped, whole)


def test_all_checkpoints_damaged_is_said(stopped: Path) -> None:
    for path in checkpoints_of(stopped):
        path.write_bytes(b"")
    said = r"all checkpoints in .* are damaged"
    with pytest.warns(RuntimeWarning), pytest.raises(RuntimeError, match=said):
        run(stopped, resume=True)


def test_stopped_run_is_not_overwritten(stopped: Path) -> None:
    said = f"{stopped} holds a run that was stopped: go on with resume=true"
    with pytest.raises(UnfinishedRunError, match=said):
        run(stopped)
    assert checkpoints_of(stopped)


def test_finished_run_that_was_stopped_as_it_went_on_is_not_overwritten(tmp_path: Path) -> None:
    run(tmp_path, trials=TRIALS - 1)
    stopped_run(tmp_path, "search", 1, resume=True)
    with pytest.raises(UnfinishedRunError):
        run(tmp_path)


def test_finished_run_is_replaced_only_if_told(whole: Path, tmp_path: Path) -> None:
    run(tmp_path / "run", seed=SEED + 1)
    before = contents(tmp_path / "run")
    with pytest.raises(FinishedRunError, match="a run that has ended: overwrite=true replaces it"):
        run(tmp_path / "run")
    assert contents(tmp_path / "run") == before
    run(tmp_path / "run", overwrite=True)
    assert_same_end(tmp_path / "run", whole)


def test_replaced_run_that_is_stopped_leaves_nothing_of_the_old_one(
    whole: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(whole, tmp_path / "run")
    stopped_run(folder, "search", 1, overwrite=True)
    left = {"run.json", "settings.yaml", "metrics.csv", "checkpoints", "figures", "run_files.json"}
    assert {path.name for path in folder.iterdir()} == left


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
    counted = lambda self: rollouts.append(1) or original(self)  # noqa: E731
    monkeypatch.setattr(RolloutCollector, "rollout", counted)
    run(stopped_run(tmp_path / "run", "search", 5), resume=True)
    assert len(rollouts) == TRIALS + 1
