"""The common parts of Figures 7a and 7b: success of several methods over seconds of experience."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median

from matplotlib.figure import Figure

from reproduction.reproduction import Results, Run, learning_run
from torch_pmil.plotting import plot_success_of_methods
from torch_pmil.runs.summaries import (
    SuccessCurve,
    read_summary,
    success_over_experience,
)
from torch_pmil.tasks.registry import load_experiment

SEEDS = range(10)  # each with its own random rollout of 2.5 s, the same for all methods
OURS = "imitation (ours)"
OUR_TRIALS = 13  # the last one with 32.5 s of experience: the paper's method needs about 33 s
THEIR_TRIALS = 20  # with 50 s, where the paper's Figure 7 ends
QUICK_SEEDS, QUICK_TRIALS = range(2), 3
GOAL = 0.95  # success rate at which the paper compares


def size(quick: bool, trials: int) -> tuple[Sequence[int], int]:
    """Seeds and number of trials."""
    return (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, trials)


def our_runs(root: Path, quick: bool) -> list[Run]:
    """The runs of the double pendulum that ``pmil train`` makes."""
    seeds, trials = size(quick, OUR_TRIALS)
    return [learning_run(root, load_experiment("double_pendulum"), seed, trials) for seed in seeds]


def experience_to_goal(summary: dict) -> float:
    """Experience (s) of a run's first trial with 95 % of success; infinite without one.

    Example:
        >>> experience_to_goal({"trials": [{"success_rate": 1.0, "experience_s": 2.5}]})
        2.5
    """
    trials = summary["trials"]
    found = [trial["experience_s"] for trial in trials if trial["success_rate"] >= GOAL]
    return min(found, default=math.inf)


def median_to_goal(summaries: Sequence[dict]) -> float | None:
    """Median of the experience to 95 % of success; None if that is never."""
    return finite_median(map(experience_to_goal, summaries))


def finite_median(numbers: Iterable[float]) -> float | None:
    """Median of numbers that may be infinite; None if it is.

    Example:
        >>> finite_median([2.0, 3.0, math.inf]), finite_median([2.0, math.inf, math.inf])
        (3.0, None)
    """
    middle = median(numbers)
    return middle if math.isfinite(middle) else None


def success_curves(folders: Sequence[Path], methods: Sequence[str]) -> dict[str, SuccessCurve]:
    """The success curve of each method, from equally many runs each, in the methods' order."""
    each = len(folders) // len(methods)
    runs = [read_summary(folder) for folder in folders]
    return {
        method: success_over_experience(runs[k * each : (k + 1) * each])
        for k, method in enumerate(methods)
    }


def success_results(
    curves: Mapping[str, SuccessCurve], headline: dict[str, float | None], name: str
) -> Results:
    """The figure of this name, and the curves as JSON has them."""
    return Results(headline, {name: success_figure(curves)}, {"curves": success_numbers(curves)})


def success_figure(curves: Mapping[str, SuccessCurve]) -> Figure:
    """The curves with their intervals."""
    return plot_success_of_methods(
        {
            method: (curve.experience_s, curve.mean, curve.lower, curve.upper)
            for method, curve in curves.items()
        }
    )


def success_numbers(curves: Mapping[str, SuccessCurve]) -> dict[str, dict[str, list[float]]]:
    """The curves as JSON has them."""
    return {
        method: {
            key: getattr(curve, key).tolist()
            for key in ("experience_s", "mean", "lower", "upper", "rates")
        }
        for method, curve in curves.items()
    }
