"""Figure 7b: imitation beside movement primitives with an inverse model (Eq. 29)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from reproduction.baselines.dmp_run import FEEDBACK_PERIOD, run_dmp
from reproduction.figure7 import (
    GOAL,
    OURS,
    THEIR_TRIALS,
    our_runs,
    size,
    success_curves,
    success_results,
)
from reproduction.reproduction import PaperExperiment, Results, Run, tell_trial
from torch_pmil.tasks.registry import load_experiment

# s, of the feedback; by folder
PERIODS = {"double_pendulum_dmp": FEEDBACK_PERIOD, "double_pendulum_dmp_10hz": 0.1}
METHODS = (OURS, "DMP, feedback at 100 Hz", "DMP, all at 10 Hz")


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours, then the primitives' with fast feedback, then those with all at 10 Hz."""
    seeds, trials = size(quick, THEIR_TRIALS)
    return our_runs(root, quick) + [
        dmp_run(root, name, seed, trials) for name in PERIODS for seed in seeds
    ]


def dmp_run(root: Path, name: str, seed: int, trials: int) -> Run:
    """A run of the baseline; one that was stopped begins anew."""
    return Run(
        root / name / f"seed_{seed}",
        partial(_learn, seed=seed, trials=trials, feedback_period=PERIODS[name]),
    )


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Experience at 95 % of each method, and success at 33 s and in the end."""
    curves = success_curves(folders, METHODS)
    headline: dict[str, float | None] = {}
    for name, curve in zip(("ours", "dmp", "dmp_10hz"), curves.values(), strict=True):
        headline |= {
            f"{name}_experience_to_95": curve.experience_to(GOAL),
            f"{name}_success_at_33s": curve.at(33.0),
            f"{name}_final_success": curve.at(float("inf")),
        }
    return success_results(curves, headline, "figure7b")


def _learn(out: Path, command: str, seed: int, trials: int, feedback_period: float) -> None:
    experiment, told = load_experiment("double_pendulum"), partial(tell_trial, out)
    run_dmp(experiment, seed, trials, out, command, feedback_period, told)


FIGURE7B = PaperExperiment(
    "figure7b", "success over experience: imitation and movement primitives", needed_runs, results
)
