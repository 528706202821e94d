"""The first motion of a run and what it decides, in the folder of the run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase

from torch_pmil.checks import check_tensor
from torch_pmil.control.tensor_file import load_tensors
from torch_pmil.envs.operator import RolloutDiscarded
from torch_pmil.files import FileError, read_json, short, write_json
from torch_pmil.runs.own_files import MOTION, SAMPLING, own
from torch_pmil.runs.run_folder import save_tensors
from torch_pmil.tasks.first_motion import GENTLER, FirstMotion, explore, ran_away
from torch_pmil.tasks.resampled import resampled
from torch_pmil.tasks.sampling_choice import Choice, choose
from torch_pmil.tasks.task import Task


def sampled(
    task: Task,
    seed: int,
    out: Path,
    resume: bool,
    before: Path | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[Task, TensorDictBase | None]:
    """The task as a run sees it, and the first motion so seen; None if that decides nothing.

    Args:
        task: to be learned.
        seed: of the run.
        out: its folder.
        resume: whether to continue the run that is there, with its motion and its sampling.
        before: folder of another run, whose sampling is taken, or whose motion gives the scale.
        report: called with what was chosen, in words, and why a robot is moved again.

    Raises:
        RunStopped, RobotError: the operator ended the run, or the robot cannot be reached.
        ValueError: a file is damaged or of another task.
    """
    if not (task.samplings or task.unscaled):
        return task, None
    if task.unscaled and before is not None:
        motion = _loaded(task, before / MOTION)
        save_tensors(own(out, MOTION), vars(motion))
        return task.scaled_by(motion.states), None  # it is part of that run's experience
    motion = _first_motion(task, seed, out, resume, report)
    if task.unscaled:
        return task.scaled_by(motion.states), motion.as_rollout(task)
    known = out if resume else before
    if known is not None and (known / SAMPLING).exists():
        choice = _read(task, known / SAMPLING)
    else:
        choice = choose(task, motion)
    write_json(own(out, SAMPLING), asdict(choice))
    report(choice.in_words(task.time_step))
    chosen = resampled(task, choice.sampling)
    return chosen, motion.as_rollout(chosen)


def discard_motion(out: Path) -> None:
    """Remove the first motion of the run in a folder, and what it decided."""
    for name in (MOTION, SAMPLING):
        (out / name).unlink(missing_ok=True)


def _first_motion(
    task: Task, seed: int, out: Path, resume: bool, report: Callable[[str], None]
) -> FirstMotion:
    """The first motion of the run in a folder, made if it is not there."""
    path = out / MOTION
    if resume and path.exists():
        return _loaded(task, path)
    motion = _explored(task, seed)
    if ran_away(task, motion):
        report(
            "the first motion ran away from what was demonstrated and is not learned from: the "
            f"robot is moved again, by {GENTLER:.0%} of the random actions"
        )
        motion = _explored(task, seed, GENTLER)
    save_tensors(own(out, MOTION), vars(motion))
    return motion


def _explored(task: Task, seed: int, share: float = 1.0) -> FirstMotion:
    """A motion that the operator, if there is one, did not discard."""
    while True:
        with suppress(RolloutDiscarded):
            return explore(task, seed, share)


def _loaded(task: Task, path: Path) -> FirstMotion:
    found: Any = load_tensors(path)
    F, D = len(task.actions.names), task.space.dim
    shapes = {"states": ("T + 1", D), "actions": ("T", F), "resting": (F,)}
    if not isinstance(found, dict) or found.keys() != shapes.keys():
        raise FileError(f"{path} must hold {', '.join(shapes)}, got {short(found)}")
    for name, shape in shapes.items():
        check_tensor(f"{path}: {name}", found[name], shape)
    return FirstMotion(**found)


def _read(task: Task, path: Path) -> Choice:
    """A choice that another process made, whose sampling must be one of the task's."""
    found: Any = read_json(path)
    wanted = asdict(Choice(task.samplings[0]))
    if isinstance(found, dict) and found.keys() == wanted.keys():
        known = [each for each in task.samplings if asdict(each) == found["sampling"]]
        if known and _are_numbers(found["lost"]) and _are_numbers(found["gained"]):
            return Choice(known[0], found["lost"], found["gained"])
    raise FileError(f"{path} must be a sampling of {task.name}, as {wanted}, got {short(found)}")


def _are_numbers(nats: object) -> bool:
    """Whether these are numbers by name, as JSON has them."""
    return isinstance(nats, dict) and all(type(value) in (int, float) for value in nats.values())
