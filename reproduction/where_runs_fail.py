"""Where runs go wrong: all failures of 240 runs, counted by cause.

Thirty seeds of eight tasks are learned, and each run is replayed
(:mod:`~reproduction.replay`): what did its model expect of each policy, and what came? Every trial
whose policy fails from more than 5 % of fresh starts is then given one cause
(:mod:`~reproduction.failure_causes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

from reproduction.handwriting import SHAPES, left_out_ratios, written
from reproduction.plots.calibration import plot_success_calibration
from reproduction.plots.counts import plot_counts
from reproduction.replay import replayed
from reproduction.replayed_runs import (
    ALL,
    Forecast,
    ReplayedRun,
    drawn,
    reliability,
    tables,
)
from reproduction.reproduction import OF_RUN, PaperExperiment, Results, Run, learning_run
from reproduction.soak.tasks import ROBOT, TASKS, SoakTask
from torch_pmil.files import read_json, write_json
from torch_pmil.plotting import Figure
from torch_pmil.runs.summaries import read_summary
from torch_pmil.tasks.handwriting import SUCCESS_RATIO
from torch_pmil.tasks.task import Task

PREDICTIONS = ("predicted_before", "predicted_after")


@dataclass(frozen=True)
class Size:
    """How much is counted.

    Args:
        tasks: what is learned.
        seeds: of each task's runs.
        trials: largest number of trials of a run.
        samples: imagined rollouts of each prediction.
    """

    tasks: Sequence[SoakTask]
    seeds: Sequence[int]
    trials: int
    samples: int


FULL = Size(TASKS, range(100, 130), trials=12, samples=100)
QUICK = Size((TASKS[0], TASKS[4]), (100,), trials=3, samples=20)


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The replay of each run, which learns it first if that was not done.

    All runs of one seed come before those of the next.
    """
    size = QUICK if quick else FULL
    experiments = [task.load() for task in size.tasks]
    return [_replay_of(root, each, seed, size) for seed in size.seeds for each in experiments]


def _replay_of(root: Path, experiment: Task, seed: int, size: Size) -> Run:
    learning = learning_run(root, experiment, seed, size.trials)
    replay = partial(_replay, learning=learning, experiment=experiment, samples=size.samples)
    return Run(root / "replays" / experiment.name / learning.out.name, replay)


def _replay(out: Path, command: str, learning: Run, experiment: Task, samples: int) -> None:
    """Learn a run, unless it is finished, and write what its replay shows."""
    if not learning.finished:
        learning.learn(learning.out, command)
    summary = read_summary(learning.out)
    kept = (*OF_RUN, "saved_trial", "saved_success_rate", "stop_reason")
    out.mkdir(parents=True, exist_ok=True)
    write_json(
        out / "summary.json",
        {name: summary[name] for name in kept} | replayed(learning.out, experiment, samples),
    )


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Counts of causes and of ends, and the calibration of what was predicted."""
    titles = {task.name: task.title for task in TASKS}
    summaries = [read_json(folder / "summary.json") for folder in folders]
    runs = [ReplayedRun.of(titles[summary["experiment"]], summary) for summary in summaries]
    found = tables(runs)
    counted = dict(found["counts"])
    total = counted.pop(ALL)
    shapes = SHAPES[ROBOT]
    writers = {shape: left_out_ratios(written(shape).demonstrations) for shape in shapes}
    inside = [ratio <= SUCCESS_RATIO for ratios in writers.values() for ratio in ratios]
    headline = {
        **total["totals"],
        **{_entry(cause): count for cause, count in total["causes"].items()},
        **_biases(runs),
        "writers_own_success": fmean(inside),
    }
    details = {
        "samples": (QUICK if quick else FULL).samples,
        **found,
        "reliability": {entry: reliability(_forecasts(runs, entry)) for entry in PREDICTIONS},
        "predictions": {
            task: _biases([run for run in runs if run.task == task]) for task in counted
        },
        "writers_left_out": writers,
    }
    return Results(headline, _figures(runs, counted), details)


def _figures(
    runs: Sequence[ReplayedRun], counted: Mapping[str, Mapping[str, Any]]
) -> dict[str, Figure]:
    """Stacked bars of the counts, and measured over predicted success rates."""
    causes, ends = (
        {task: found[entry] for task, found in counted.items()} for entry in ("causes", "ends")
    )
    predictions = {
        f"{when} its own rollout": drawn(_forecasts(runs, entry))
        for when, entry in zip(("before", "after"), PREDICTIONS, strict=True)
    }
    return {
        "causes": plot_counts(
            {"trials that fail from more than 5 % of the starts": causes, "runs": ends}
        ),
        "predicted_success": plot_success_calibration(predictions),
    }


def _entry(cause: str) -> str:
    """Name of a cause in the headline.

    Example:
        >>> _entry("model not right, and unsure")
        'trials_model_not_right_and_unsure'
    """
    return "_".join(["trials", *cause.replace(",", "").split()])


def _forecasts(runs: Sequence[ReplayedRun], entry: str) -> list[Forecast]:
    return [forecast for run in runs for forecast in run.forecasts(entry)]


def _biases(runs: Sequence[ReplayedRun]) -> dict[str, float]:
    """Mean of predicted minus measured success rates, and of its absolute value."""
    found = {}
    for entry in PREDICTIONS:
        off = [forecast.predicted - forecast.measured for forecast in _forecasts(runs, entry)]
        found[f"{entry}_bias"] = fmean(off)
        found[f"{entry}_error"] = fmean(map(abs, off))
    return found


WHERE_RUNS_FAIL = PaperExperiment(
    "where_runs_fail", "why policies fail, counted over 240 runs", needed_runs, results
)
