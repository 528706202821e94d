"""Handwriting (Section 5.2 with other people's data): strokes of the LASA set, written by two
robots, three seeds each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from reproduction.learned import load_learned
from reproduction.reproduction import PaperExperiment, Report, Run, learning_run
from torch_pmil.experiments.runs.summaries import read_summary
from torch_pmil.experiments.tasks.handwriting import Handwriting, Writing, handwriting
from torch_pmil.plotting import plot_writing

SHAPES = {
    "double_pendulum": ("Angle", "Sshape", "GShape", "Sine"),
    "biorob": ("Angle", "GShape"),
}  # those that it was developed on
SEEDS, TRIALS = range(3), 12
QUICK_SHAPES, QUICK_TRIALS = {"double_pendulum": ("Angle",)}, 2
STARTS, START_SEED = 10, 7_000_000  # drawn strokes of the robot, from starts that no run has seen


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """As ``pmil train experiment=handwriting shape=... robot=...`` learns; one seed of all after
    another.
    """
    seeds, trials = (SEEDS[:1], QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, _experiment(shape, robot), seed, trials)
        for seed in seeds
        for robot, shape in _tasks(quick)
    ]


def report(folders: Sequence[Path], quick: bool) -> Report:
    """Ratio of the rms error to the writers' spread and experience, medians over the seeds; seed 0
    is drawn.
    """
    tasks = _tasks(quick)
    of_task = {task: folders[index :: len(tasks)] for index, task in enumerate(tasks)}
    runs = {task: [read_summary(folder) for folder in folders] for task, folders in of_task.items()}
    headline: dict[str, float | None] = {}
    for (robot, shape), summaries in runs.items():
        headline[f"{robot}_{shape}_ratio"] = median(ratio(run) for run in summaries)
        headline[f"{robot}_{shape}_experience_s"] = median(run["experience_s"] for run in summaries)
    headline["worst_ratio"] = max(ratio(run) for summaries in runs.values() for run in summaries)
    figures = {
        robot: plot_writing({s: writing(of_task[r, s][0], s, r) for r, s in tasks if r == robot})
        for robot in dict(tasks)
    }
    measured = [
        measured_run(shape, robot, run)
        for (robot, shape), summaries in runs.items()
        for run in summaries
    ]
    return Report(headline, figures, {"measured": measured})


def ratio(run: dict) -> float:
    """Root mean square distance of the saved policy's fresh rollouts from the mean stroke, over the
    writers' own spread.

    A further stroke of the same writer would have about 1, more exactly :math:`\\sqrt{1 + 1/N}`.

    Example:
        >>> ratio({"rms_error": {"x": 0.03, "y": 0.04}, "demonstration_spread": {"x": 0.05, "y": 0.0}})
        1.0
    """
    return _norm(run["rms_error"]) / _norm(run["demonstration_spread"])


def measured_run(shape: str, robot: str, run: dict) -> dict[str, object]:
    """What a run came to, for the details."""
    keys = (
        "seed",
        "saved_trial",
        "saved_success_rate",
        "experience_s",
        "two_sigma_coverage",
        "stop_reason",
        "wall_seconds",
    )
    lengths = {
        "rms_error_m": _norm(run["rms_error"]),
        "writers_spread_m": _norm(run["demonstration_spread"]),
    }
    return {
        "shape": shape,
        "robot": robot,
        "ratio": ratio(run),
        **lengths,
        **{key: run[key] for key in keys},
    }


def writing(folder: Path, shape: str, robot: str) -> Writing:
    """The people's strokes and those of a run's policy, in the plane."""
    experiment = _experiment(shape, robot)
    learned = load_learned(folder, experiment)
    return experiment.writing(
        learned.predicted(experiment), learned.rollouts(experiment, STARTS, START_SEED)
    )


def _experiment(shape: str, robot: str) -> Handwriting:
    return handwriting(shape=shape, robot=robot)


def _tasks(quick: bool) -> list[tuple[str, str]]:
    return [
        (robot, shape)
        for robot, shapes in (QUICK_SHAPES if quick else SHAPES).items()
        for shape in shapes
    ]


def _norm(by_entry: dict[str, float]) -> float:
    return math.hypot(*by_entry.values())


HANDWRITING = PaperExperiment(
    "handwriting", "people's strokes, written by the pendulum and the BioRob", needed_runs, report
)
