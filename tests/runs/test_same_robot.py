"""A run goes on with the robot that it began with; another one begins a run with its experience."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from tests.helpers.short_run import STEPS, quick_fits, run, short_experiment, stopped_run
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.runs import same_robot
from torch_pmil.runs.same_robot import motion_of
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.checkpoints import newest_undamaged, rotation_in


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        yield


class Changed(DoublePendulumEnv):
    """The same robot with other numbers in its model."""

    def __init__(self, *args: object, entry: str, factor: float, **given: object) -> None:
        super().__init__(*args, **given)
        getattr(self.model, entry)[:] *= factor


def changed(entry: str, factor: float) -> Task:
    task = short_experiment()
    return replace(task, make_env=partial(Changed, entry=entry, factor=factor))


def experience_of(folder: Path) -> list[torch.Tensor]:
    """The observations learned from until and in the newest checkpoint."""
    rotation = rotation_in(folder / "checkpoints")
    saved = newest_undamaged(rotation)
    state = saved.states["trainer_module.experience"]
    known = [state["transitions"]["observation"]] if state["count"] else []
    return [*known, saved.states["collector"]["latest"]["entries"]["observation"]]


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("entry", ["body_mass", "actuator_gear", "body_inertia"])
def test_motion_shows_each_change_of_a_robot_and_is_the_same_without(entry: str) -> None:
    assert motion_of(changed(entry, 1.0)) == motion_of(short_experiment()) != None  # noqa: E711
    theirs, ours = motion_of(short_experiment()), motion_of(changed(entry, 1.01))
    assert not same_robot.moves_alike(ours, theirs)
    assert same_robot.moves_alike(theirs, theirs)


def test_robot_that_is_not_measured_is_not_moved_and_a_varying_one_is_not_compared() -> None:
    def moved(**given: object) -> None:
        raise AssertionError

    task = short_experiment(evaluated=False, make_env=moved)
    assert motion_of(task) is None
    noises = iter(range(100))
    varying = lambda **given: Changed(entry="body_mass", factor=1 + next(noises), **given)  # noqa: E731
    assert motion_of(replace(short_experiment(), make_env=varying)) is None


def test_changed_robot_is_refused_and_its_run_begins_with_the_experience_of_the_other(
    tmp_path: Path,
) -> None:
    old, new, heavier = tmp_path / "old", tmp_path / "new", changed("body_mass", 1.5)
    run(old, task=short_experiment(), trials=1)
    before = contents(old)
    with pytest.raises(ValueError, match=r"moves otherwise under the same actions: another out"):
        run(old, task=heavier, trials=2, resume=True)
    assert contents(old) == before
    result = run(new, task=replace(heavier, name="heavier"), trials=2, resume=old)
    assert contents(old) == before
    theirs, ours = torch.cat(experience_of(old)), torch.cat(experience_of(new))
    assert len(theirs) == 2 * STEPS and len(ours) == (2 + 3) * STEPS
    assert torch.equal(ours[: len(theirs)], theirs)
    assert len(result.dynamics.train_inputs) == len(ours)
    assert [trial.trial for trial in result.trials] == [1, 2]
    assert result.trials[0].experience_s == pytest.approx(0.1 * 3 * STEPS)


def test_run_that_began_with_another_goes_on_to_the_same_end(tmp_path: Path) -> None:
    old, task = tmp_path / "old", changed("body_mass", 1.5)
    run(old, task=short_experiment(), trials=1)
    whole = run(tmp_path / "whole", task=task, trials=2, resume=old)
    stopped_run(tmp_path / "stopped", "search", 2, task=task, trials=2, resume=old)
    again = run(tmp_path / "stopped", task=task, trials=2, resume=True)
    ours, theirs = (each.policy.policy.state_dict() for each in (again, whole))
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)


@pytest.mark.parametrize("folder", ["nowhere", "run"])
def test_folder_without_another_run_is_refused(folder: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="resume must be true or the folder of another run, got"):
        run(tmp_path / "run", task=short_experiment(), resume=tmp_path / folder)
