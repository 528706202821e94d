"""The tasks of the soak, and the order of their runs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

from reproduction.handwriting import SHAPES, written
from reproduction.soak.processes import Job
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

ROBOT = "double_pendulum"  # which writes


@dataclass(frozen=True)
class SoakTask:
    """A task as ``pmil train`` names it.

    Args:
        experiment: its name there.
        title: what pages and figures call it.
        shape: what is written, for handwriting.

    Example:
        >>> SoakTask("handwriting", "handwriting Angle", "Angle").name
        'handwriting_Angle_double_pendulum'
    """

    experiment: str
    title: str
    shape: str | None = None

    @property
    def name(self) -> str:
        """Name of the folder of its runs, and in the results."""
        return f"handwriting_{self.shape}_{ROBOT}" if self.shape else self.experiment

    @property
    def settings(self) -> list[str]:
        """The words of the command line that name it."""
        strokes = [f"demonstrations=lasa:{self.shape}"] if self.shape else []
        return [f"experiment={self.experiment}", *strokes]

    def load(self) -> Task:
        """The experiment; raises ImportError where the LASA set is not installed."""
        return written(self.shape) if self.shape else load_experiment(self.experiment)


TASKS = (
    SoakTask("double_pendulum", "double pendulum"),
    SoakTask("gym_pendulum", "Pendulum-v1"),
    SoakTask("inverted_pendulum", "inverted pendulum"),
    SoakTask("biorob", "BioRob"),
    *(SoakTask("handwriting", f"handwriting {shape}", shape) for shape in SHAPES[ROBOT]),
)


@dataclass(frozen=True)
class SoakRun:
    """A task with a seed, in a folder of its own.

    Args:
        task: what is learned.
        seed: of the run.
        folder: of the run.
    """

    task: SoakTask
    seed: int
    folder: Path

    def load(self) -> Task:
        """The task as ``pmil train`` learns and names it; errors as in :meth:`SoakTask.load`."""
        return replace(self.task.load(), name=self.task.experiment)

    @property
    def job(self) -> Job:
        """The process that learns it, or goes on with it where it was stopped."""
        settings = [*self.task.settings, f"seed={self.seed}", f"out={self.folder}", "resume=true"]
        return Job(self.folder, (sys.executable, "-m", "torch_pmil", "train", *settings))


def first_runs(number: int, first_seed: int, root: Path) -> list[SoakRun]:
    """So many runs, seed by seed through all tasks; more of them begin with the same ones.

    Args:
        number: of runs.
        first_seed: of all tasks.
        root: below which each run has its folder.

    Example:
        >>> runs = first_runs(12, 0, Path("runs/soak"))
        >>> [(str(run.folder), run.seed) for run in (runs[3], runs[11])]
        [('runs/soak/biorob/seed_0', 0), ('runs/soak/biorob/seed_1', 1)]
    """
    return list(islice(_runs(first_seed, root), number))


def _runs(first_seed: int, root: Path) -> Iterator[SoakRun]:
    for seed in count(first_seed):
        for task in TASKS:
            yield SoakRun(task, seed, root / task.name / f"seed_{seed}")
