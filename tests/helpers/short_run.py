"""A learning run of seconds, and ways to stop it; as a script it is a process for a test to kill.

    python -m tests.helpers.short_run FOLDER [PHASE COUNT]

prints ``stopped`` when it comes to that phase for the COUNT-th time, and waits to be killed.
"""

from __future__ import annotations

import math
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partialmethod
from pathlib import Path

import pytest
import torch
from torchrl.checkpoint import Checkpoint

from torch_pmil.control.exploration import PDMovements
from torch_pmil.envs.mujoco import MujocoRobotEnv
from torch_pmil.gp.hyperparameters import pilco_starts
from torch_pmil.model import dynamics
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.runs import training
from torch_pmil.runs.training import RunResult, train
from torch_pmil.search import policy_search
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.tasks.task import Task

STEPS, TRIALS, SEED = 4, 3, 5
COMMAND = f"pmil train seed={SEED}"
HANGING = torch.tensor([math.pi, 0.0, 0.0, 0.0], dtype=torch.float64)
REACH = torch.tensor([0.1, 0.0, 0.1, 0.0], dtype=torch.float64)
GAIN = torch.tensor([[1.0, 0.2, 0.0, 0.0], [0.0, 0.0, 1.0, 0.2]], dtype=torch.float64)
LIMITS = torch.tensor([3.5, 3.5], dtype=torch.float64)
PD_MOVEMENTS = PDMovements(
    HANGING, REACH, GAIN, LIMITS, 3, 2, 7, lambda state: torch.zeros_like(state[..., :2])
)
PHASES = {  # what is called there
    "collection": (MujocoRobotEnv, "_step"),
    "fit": (dynamics, "find_hyperparameters"),
    "search": (policy_search, "minimise_function"),
    "evaluation": (MujocoRobotEnv, "_step"),
    "writing": (zipfile.ZipFile, "write"),
    "renaming": (Checkpoint, "_publish_path"),
}


def short_experiment(steps: int = STEPS, name: str = "double_pendulum", **changes: object) -> Task:
    """A task of the package, :func:`shortened`."""
    return shortened(load_experiment(name), steps, **changes)


def shortened(task: Task, steps: int, **changes: object) -> Task:
    """The first steps of a task, with five basis functions and searches of a few evaluations.

    Args:
        changes: settings and groups of them, and fields of the task.
    """
    quick = {"num_centres": 5, "search": SearchSettings(1, 1, 1, first_horizon=1.0)}
    if isinstance(task, CostTask):
        return changed(task, **{"steps": steps} | quick | changes)
    shown = replace(task.demonstrations, positions=task.demonstrations.positions[:, : steps + 1])
    return changed(task, **{"demonstrations": shown} | quick | changes)


def changed(task: Task, **changes: object) -> Task:
    """A task with other fields, groups of settings and settings, by their names."""
    own = {entry.name for entry in fields(task)} & changes.keys()
    settings = {name: value for name, value in changes.items() if name not in own}
    return replace(task, **{name: changes[name] for name in own}).with_settings(**settings)


def quick_fits(patch: pytest.MonkeyPatch) -> None:
    """Let the model's fits begin at one start and end after a few iterations."""
    patch.setattr(GPDynamics, "fit", partialmethod(GPDynamics.fit, max_iterations=3))
    patch.setattr(dynamics, "pilco_starts", lambda *data: pilco_starts(*data)[:1])


def replace_task(patch: pytest.MonkeyPatch, task: Task, name: str = "double_pendulum") -> None:
    """Let a name stand for another task, whatever the demonstrations."""
    module = f"torch_pmil.tasks.{EXPERIMENTS[name].module}"
    patch.setattr(f"{module}.{name}", lambda demonstrations=None: task)


def stalling(name: str = "double_pendulum", trust: float = 1e-9, **changes: object) -> Task:
    """A short task of which no step counts as matched: searches stall and begin anew."""
    search = SearchSettings(1, 1, 1, first_horizon=1.0, trust_threshold=trust)
    return short_experiment(name=name, search=search, **changes)


def run(
    folder: Path, resume: bool = False, task: Task | None = None, **changes: object
) -> RunResult:
    """Learn a short task, or continue."""
    arguments = {"seed": SEED, "trials": TRIALS, "command": COMMAND, **changes}
    return train(task or stalling(), out=folder, progress_bar=False, resume=resume, **arguments)


def stop_in(patch: pytest.MonkeyPatch, phase: str, count: int, stop: Callable[[], None]) -> None:
    """Call ``stop`` where a phase is reached for the COUNT-th time."""
    owner, name = PHASES[phase]
    # the motion by which a change of the robot shows is no collection
    patch.setattr(training, "motion_of", lambda task: None)
    original, reached = getattr(owner, name), 0

    def stopping(*args: object, **kwargs: object) -> object:
        nonlocal reached
        robots = {"collection": 0, "evaluation": 1}.get(phase)
        reached += robots is None or len(args[0].batch_size) == robots
        if reached == count:
            reached += 1
            stop()
        return original(*args, **kwargs)

    patch.setattr(owner, name, staticmethod(stopping) if name == "_publish_path" else stopping)


class Stopped(BaseException):
    """As sudden as a kill, inside one process."""


def stop() -> None:
    """End whatever is going on."""
    raise Stopped


def stopped_run(
    folder: Path, phase: str, count: int, task: Task | None = None, **changes: object
) -> Path:
    """The folder of a run that was stopped where a phase is reached for the COUNT-th time."""
    with pytest.MonkeyPatch.context() as patch:
        stop_in(patch, phase, count, stop)
        with pytest.raises(Stopped):
            run(folder, task=task, **changes)
    return folder


def wait_to_be_killed() -> None:
    """Say so, and never go on."""
    print("stopped", flush=True)
    time.sleep(600)


if __name__ == "__main__":
    with pytest.MonkeyPatch.context() as patch:
        quick_fits(patch)
        if len(sys.argv) > 2:
            stop_in(patch, sys.argv[2], int(sys.argv[3]), wait_to_be_killed)
        run(Path(sys.argv[1]), resume=Path(sys.argv[1]).exists())
