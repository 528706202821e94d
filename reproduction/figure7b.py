"""Figure 7b: imitation beside movement primitives that an inverse model and a PD controller track
(Eq. 29).
"""

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
    success_report,
)
from reproduction.reproduction import PaperExperiment, Report, Run, tell_trial
from torch_pmil.experiments import load_experiment

PERIODS = {
    "double_pendulum_dmp": FEEDBACK_PERIOD,
    "double_pendulum_dmp_10hz": 0.1,
}  # s, of the feedback; by folder
METHODS = (OURS, "DMP, feedback at 100 Hz", "DMP, all at 10 Hz")


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours, then the primitives' with fast feedback, then those with all at 10 Hz."""
    seeds, trials = size(quick, THEIR_TRIALS)
    return our_runs(root, quick) + [
        dmp_run(root, name, seed, trials) for name in PERIODS for seed in seeds
    ]


def dmp_run(root: Path, name: str, seed: int, trials: int) -> Run:
    """A run of the baseline: ``reproduction.baselines.train_dmp`` makes the same. One that was
    stopped begins anew.
    """
    return Run(
        root / name / f"seed_{seed}",
        partial(_learn, seed=seed, trials=trials, feedback_period=PERIODS[name]),
    )


def report(folders: Sequence[Path], quick: bool) -> Report:
    """When each is at 95 %, and how good at 33 s and in the end."""
    curves = success_curves(folders, METHODS)
    headline: dict[str, float | None] = {}
    for name, curve in zip(("ours", "dmp", "dmp_10hz"), curves.values(), strict=True):
        headline |= {
            f"{name}_experience_to_95": curve.experience_to(GOAL),
            f"{name}_success_at_33s": curve.at(33.0),
            f"{name}_final_success": curve.at(float("inf")),
        }
    return success_report(curves, headline, "figure7b")


def _learn(out: Path, command: str, seed: int, trials: int, feedback_period: float) -> None:
    run_dmp(
        load_experiment("double_pendulum"),
        seed,
        trials,
        out,
        command,
        feedback_period,
        partial(tell_trial, out),
    )


FIGURE7B = PaperExperiment(
    "figure7b", "success over experience: imitation and movement primitives", needed_runs, report
)
