"""Where runs go wrong: all failures of 240 runs, counted by cause.

Thirty seeds of eight tasks are learned, and each run is replayed
(:mod:`~reproduction.replay`): what did its model expect of each policy, and what came? Every trial
whose policy fails from more than 5 % of fresh starts is then given one cause
(:mod:`~reproduction.failure_causes`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

from scipy.stats import binomtest

from reproduction.delay_calibration import AHEAD
from reproduction.failure_causes import (
    CAUSES,
    ENDS,
    UNSURE,
    ReplayedTrial,
    cause_of,
    end_of,
    trials_not_needed,
)
from reproduction.handwriting import SHAPES, left_out_ratios
from reproduction.replay import replayed
from reproduction.reproduction import OF_RUN, PaperExperiment, Results, Run, learning_run
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.diagnosis.causes import COVERED
from torch_pmil.experiments.runs.summaries import is_finished, read_summary
from torch_pmil.experiments.tasks.experiment import Experiment
from torch_pmil.experiments.tasks.handwriting import SUCCESS_RATIO, handwriting
from torch_pmil.files import read_json, write_json
from torch_pmil.plotting import Figure
from torch_pmil.plotting.calibration import plot_success_calibration
from torch_pmil.plotting.counts import plot_counts

WRITTEN = SHAPES["double_pendulum"]
TASKS: dict[str, Callable[[], Experiment]] = {
    "double pendulum": partial(load_experiment, "double_pendulum"),
    "Pendulum-v1": partial(load_experiment, "gym_pendulum"),
    "inverted pendulum": partial(load_experiment, "inverted_pendulum"),
    "BioRob": partial(load_experiment, "biorob"),
    **{f"handwriting {shape}": partial(handwriting, shape=shape) for shape in WRITTEN},
}
# success rates between which predictions are pooled
EDGES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.75, 0.85, 0.9, 0.95, 1.0)
PREDICTIONS = ("predicted_before", "predicted_after")


@dataclass(frozen=True)
class Size:
    """How much is counted.

    Args:
        tasks: of ``TASKS``.
        seeds: of each task's runs.
        trials: largest number of trials of a run.
        samples: imagined rollouts of each prediction.
    """

    tasks: Sequence[str]
    seeds: Sequence[int]
    trials: int
    samples: int


FULL = Size(tuple(TASKS), range(100, 130), trials=12, samples=100)
QUICK = Size(("double pendulum", "handwriting Angle"), (100,), trials=3, samples=20)


@dataclass(frozen=True)
class ReplayedRun:
    """A run, as its replay left it.

    Args:
        task: of ``TASKS``.
        summary: what the replay wrote.
        trials: of it.
    """

    task: str
    summary: dict[str, Any]
    trials: Sequence[ReplayedTrial]

    @classmethod
    def read(cls, folder: Path, names: Mapping[str, str]) -> ReplayedRun:
        """A replay's results; ``names`` has the task of each experiment by its name."""
        summary = read_json(folder / "summary.json")
        trials = [ReplayedTrial(**trial) for trial in summary["replayed"]]
        return cls(names[summary["experiment"]], summary, trials)

    @property
    def first_success(self) -> int:
        """Number of the first trial whose own rollout succeeded; beyond the last if none did."""
        return next((t.trial for t in self.trials if t.own_success), len(self.trials) + 1)

    @property
    def end(self) -> str:
        """How it ended, of ``ENDS``."""
        entries = ("saved_success_rate", "predicted_saved", "stop_reason")
        return end_of(*(self.summary[entry] for entry in entries))

    @property
    def wrong_one_step(self) -> int:
        """Trials whose model was unsure, and wrong about single steps already."""
        moved = self.summary["moved"]
        unsure = [t for t in self.trials if cause_of(t, moved) == UNSURE]
        return sum(t.covered < COVERED for t in unsure)

    def causes(self, after_success: bool = False) -> Counter[str]:
        """Failed trials by cause: all, or those after the first own success alone."""
        first = self.first_success if after_success else 0
        found = [cause_of(t, self.summary["moved"]) for t in self.trials if t.trial > first]
        return Counter(cause for cause in found if cause is not None)


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The replay of each run, which learns it first if that was not done.

    All runs of one seed come before those of the next.
    """
    size = QUICK if quick else FULL
    experiments = [TASKS[task]() for task in size.tasks]
    return [_replay_of(root, each, seed, size) for seed in size.seeds for each in experiments]


def _replay_of(root: Path, experiment: Experiment, seed: int, size: Size) -> Run:
    learning = learning_run(root, experiment, seed, size.trials)
    replay = partial(_replay, learning=learning, experiment=experiment, samples=size.samples)
    return Run(root / "replays" / experiment.name / learning.out.name, replay)


def _replay(out: Path, command: str, learning: Run, experiment: Experiment, samples: int) -> None:
    """Learn a run, unless it is finished, and write what its replay tells."""
    if not is_finished(learning.out):
        learning.learn(learning.out, command)
    summary = read_summary(learning.out)
    told = (*OF_RUN, "saved_trial", "saved_success_rate", "stop_reason")
    out.mkdir(parents=True, exist_ok=True)
    write_json(
        out / "summary.json",
        {name: summary[name] for name in told} | replayed(learning.out, experiment, samples),
    )


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Counts of causes and of ends, and the calibration of what was predicted."""
    names = {make().name: task for task, make in TASKS.items()}
    runs = [ReplayedRun.read(folder, names) for folder in folders]
    by_task = {task: [run for run in runs if run.task == task] for task in TASKS}
    by_task = {task: found for task, found in by_task.items() if found}
    counted = {task: counts(found) for task, found in by_task.items()}
    total = counts(runs)
    binned = {entry: reliability(runs, entry) for entry in PREDICTIONS}
    writers = {shape: left_out_ratios(handwriting(shape=shape).demonstrations) for shape in WRITTEN}
    inside = [ratio <= SUCCESS_RATIO for ratios in writers.values() for ratio in ratios]
    coverage = {task: coverage_ahead(found) for task, found in by_task.items()}
    headline = {
        **total["totals"],
        **{_entry(cause): count for cause, count in total["causes"].items()},
        **_biases(runs),
        "writers_own_success": fmean(inside),
    }
    details = {
        "samples": (QUICK if quick else FULL).samples,
        "counts": counted | {"all": total},
        "coverage_ahead": coverage | {"all": coverage_ahead(runs)},
        "reliability": binned,
        "predictions": {task: _biases(found) for task, found in by_task.items()},
        "writers_left_out": writers,
    }
    return Results(headline, _figures(runs, counted, binned), details)


def _figures(
    runs: Sequence[ReplayedRun],
    counted: Mapping[str, Mapping[str, Any]],
    binned: Mapping[str, Sequence[Mapping[str, float]]],
) -> dict[str, Figure]:
    """Stacked bars of the counts, and measured over predicted success rates."""
    causes, ends = (
        {task: found[entry] for task, found in counted.items()} for entry in ("causes", "ends")
    )
    predictions = {
        f"{when} its own rollout": _points(runs, entry, binned[entry])
        for when, entry in zip(("before", "after"), PREDICTIONS, strict=True)
    }
    return {
        "causes": plot_counts(
            {"trials that fail from more than 5 % of the starts": causes, "runs": ends}
        ),
        "predicted_success": plot_success_calibration(predictions),
    }


def counts(runs: Sequence[ReplayedRun]) -> dict[str, Any]:
    """Trials by cause and runs by end.

    Returns:
        ``causes``, ``causes_after_success`` (after the first own success of a run) and ``ends``, by
        their names, and ``totals``.
    """
    causes, late = (
        sum((run.causes(after) for run in runs), Counter[str]()) for after in (False, True)
    )
    ends = Counter(run.end for run in runs)
    totals = {
        "runs": len(runs),
        "runs_not_learned": len(runs) - ends["learned"],
        "runs_ended_by_luck": sum(ends[end] for end in ENDS if "luck" in end),
        "runs_ended_by_luck_known": ends["ended by luck, and the model knew"],
        "trials": sum(len(run.trials) for run in runs),
        "trials_failed": causes.total(),
        "trials_wrong_one_step": sum(run.wrong_one_step for run in runs),
        "trials_not_needed": sum(trials_not_needed(run.trials) for run in runs),
    }
    return {
        "causes": {cause: causes[cause] for cause in CAUSES},
        "causes_after_success": {cause: late[cause] for cause in CAUSES},
        "ends": {end: ends[end] for end in ENDS},
        "totals": totals,
    }


def reliability(runs: Sequence[ReplayedRun], entry: str) -> list[dict[str, float]]:
    """Mean predicted and measured success rates of the trials in each bin of the prediction.

    Args:
        runs: of any tasks.
        entry: of a :class:`ReplayedTrial`, the prediction.

    Returns:
        Bins with a trial, each with ``trials``, ``predicted``, ``measured``, and ``lower`` and
        ``upper``, the 95 % interval of Clopper and Pearson of all its measured rollouts.
    """
    trials = [trial for run in runs for trial in run.trials]
    bins = []
    for low, high in pairwise(EDGES):
        held = [t for t in trials if low <= getattr(t, entry) < high + (high == EDGES[-1])]
        if held:
            successes = sum(round(t.success_rate * t.n_eval) for t in held)
            interval = binomtest(successes, sum(t.n_eval for t in held)).proportion_ci()
            bins.append(
                {
                    "trials": len(held),
                    "predicted": fmean(getattr(t, entry) for t in held),
                    "measured": fmean(t.success_rate for t in held),
                    "lower": interval.low,
                    "upper": interval.high,
                }
            )
    return bins


def coverage_ahead(runs: Sequence[ReplayedRun]) -> dict[str, dict[str, float]]:
    """Two-sigma coverage by the number of steps ahead, up to the first own success and after.

    Means over trials, of models that had not learned from the rollouts in question.
    """
    trials = {
        "up_to_first_success": [t for r in runs for t in r.trials if t.trial <= r.first_success],
        "after": [t for r in runs for t in r.trials if t.trial > r.first_success],
    }
    found: dict[str, dict[str, float]] = {when: {} for when in trials}
    for when, held in trials.items():
        for steps in map(str, AHEAD):
            covered = [t.coverage_ahead[steps] for t in held if steps in t.coverage_ahead]
            if covered:
                found[when][steps] = fmean(covered)
    return found


def _entry(cause: str) -> str:
    """Name of a cause in the headline.

    Example:
        >>> _entry("model not right, and unsure")
        'trials_model_not_right_and_unsure'
    """
    return "_".join(["trials", *cause.replace(",", "").split()])


def _biases(runs: Sequence[ReplayedRun]) -> dict[str, float]:
    """Mean of predicted minus measured success rates, and of its absolute value."""
    found = {}
    for entry in PREDICTIONS:
        off = [getattr(trial, entry) - trial.success_rate for run in runs for trial in run.trials]
        found[f"{entry}_bias"] = fmean(off)
        found[f"{entry}_error"] = fmean(map(abs, off))
    return found


def _points(
    runs: Sequence[ReplayedRun], entry: str, bins: Sequence[Mapping[str, float]]
) -> dict[str, Any]:
    """What is drawn of a prediction: its trials and bins."""
    drawn = ("predicted", "measured", "lower", "upper")
    return {
        "trials": [(getattr(t, entry), t.success_rate) for run in runs for t in run.trials],
        "bins": [[held[name] for name in drawn] for held in bins],
    }


WHERE_RUNS_FAIL = PaperExperiment(
    "where_runs_fail", "why policies fail, counted over 240 runs", needed_runs, results
)
