"""Handwriting: strokes of the LASA set, written by two robots, ten seeds each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median

import torch

from reproduction.learned import load_learned
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.plotting import plot_writing
from torch_pmil.runs.summaries import read_summary
from torch_pmil.tasks.handwriting import (
    SUCCESS_RATIO,
    Writing,
    handwriting,
    handwriting_biorob,
    writing_of,
)
from torch_pmil.tasks.strokes import distance_from_mean, distance_spread, lasa_strokes
from torch_pmil.tasks.task import Task

# the shapes that the experiment was developed on
SHAPES = {"double_pendulum": ("Angle", "Sshape", "GShape", "Sine"), "biorob": ("Angle", "GShape")}
TASKS = {"double_pendulum": handwriting, "biorob": handwriting_biorob}
SEEDS, TRIALS = range(10), 12
QUICK_SHAPES, QUICK_TRIALS = {"double_pendulum": ("Angle",)}, 2
STARTS, START_SEED = 10, 7_000_000  # drawn strokes of the robot, from starts that no run has seen
FROM_SUMMARY = (
    "seed",
    "saved_trial",
    "saved_success_rate",
    "experience_s",
    "two_sigma_coverage",
    "stop_reason",
    "wall_seconds",
)


def written(shape: str, robot: str = "double_pendulum") -> Task:
    """The task in which a robot writes a shape of the LASA set.

    Raises:
        ImportError: the set is not installed.
    """
    task = TASKS[robot](lasa_strokes(shape))
    return replace(task, name=f"handwriting_{shape}_{robot}")


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The runs of ``pmil train experiment=handwriting demonstrations=lasa:...``.

    All runs of one seed come before those of the next.
    """
    seeds, trials = (SEEDS[:1], QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, written(shape, robot), seed, trials)
        for seed in seeds
        for robot, shape in _tasks(quick)
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Error over the writers' spread, and experience, medians over the seeds; seed 0 is drawn."""
    tasks = _tasks(quick)
    of_task = {task: folders[index :: len(tasks)] for index, task in enumerate(tasks)}
    runs = {task: [read_summary(folder) for folder in folders] for task, folders in of_task.items()}
    headline: dict[str, float | None] = {}
    for (robot, shape), summaries in runs.items():
        headline[f"{robot}_{shape}_ratio"] = median(ratio(run) for run in summaries)
        headline[f"{robot}_{shape}_experience_s"] = median(run["experience_s"] for run in summaries)
    headline["worst_ratio"] = max(ratio(run) for summaries in runs.values() for run in summaries)
    headline["writers_own_success"] = writers_own_success({shape for _, shape in tasks})
    figures = {
        robot: plot_writing({s: writing(of_task[r, s][0], s, r) for r, s in tasks if r == robot})
        for robot in dict(tasks)
    }
    measured = [
        measured_run(shape, robot, run)
        for (robot, shape), summaries in runs.items()
        for run in summaries
    ]
    return Results(headline, figures, {"measured": measured})


def ratio(run: dict) -> float:
    """Error of the saved policy's fresh rollouts over the writers' own spread.

    Both are root mean square distances from the mean stroke.

    A further stroke of the same writer would have about 1, more exactly :math:`\\sqrt{1 + 1/N}`.

    Example:
        >>> error, spread = {"x": 0.03, "y": 0.04}, {"x": 0.05, "y": 0.0}
        >>> ratio({"rms_error": error, "demonstration_spread": spread})
        1.0
    """
    return _norm(run["rms_error"]) / _norm(run["demonstration_spread"])


def writers_own_success(shapes: Iterable[str]) -> float:
    """Fraction of people's strokes that would be a success beside the others of their shape."""
    ratios = [left_out_ratios(written(shape).demonstrations) for shape in shapes]
    return fmean(ratio <= SUCCESS_RATIO for of_shape in ratios for ratio in of_shape)


def left_out_ratios(strokes: Demonstrations) -> list[float]:
    """Error of each stroke of the writer over the spread of the others: what people reach.

    The error is the distance from the mean of the others.

    Example:
        >>> still = torch.tensor([[0.0], [0.0]]).expand(3, 2, 2)
        >>> apart = still + torch.tensor([-1.0, 0.0, 4.0])[:, None, None]
        >>> ratios = left_out_ratios(Demonstrations(apart, 0.1, ("x", "y")))
        >>> [round(ratio, 2) for ratio in ratios]
        [1.06, 0.42, 6.36]
    """
    positions = strokes.positions
    rest = [torch.cat([positions[:n], positions[n + 1 :]]) for n in range(len(positions))]
    others = [replace(strokes, positions=kept) for kept in rest]
    return [
        distance_from_mean(stroke, kept).item() / distance_spread(kept)
        for stroke, kept in zip(positions, others, strict=True)
    ]


def measured_run(shape: str, robot: str, run: dict) -> dict[str, object]:
    """The main numbers of a run, for the details."""
    measured = {
        "shape": shape,
        "robot": robot,
        "ratio": ratio(run),
        "rms_error_m": _norm(run["rms_error"]),
        "writers_spread_m": _norm(run["demonstration_spread"]),
    }
    return measured | {key: run[key] for key in FROM_SUMMARY}


def writing(folder: Path, shape: str, robot: str) -> Writing:
    """The people's strokes and those of a run's policy, in the plane."""
    task = written(shape, robot)
    learned = load_learned(folder, task)
    rollouts = learned.rollouts(task, STARTS, START_SEED)
    return writing_of(task, learned.predicted(task), rollouts)


def _tasks(quick: bool) -> list[tuple[str, str]]:
    return [
        (robot, shape)
        for robot, shapes in (QUICK_SHAPES if quick else SHAPES).items()
        for shape in shapes
    ]


def _norm(by_entry: dict[str, float]) -> float:
    return math.hypot(*by_entry.values())


HANDWRITING = PaperExperiment(
    "handwriting", "people's strokes, written by the pendulum and the BioRob", needed_runs, results
)
