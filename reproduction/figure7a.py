"""Figure 7a: imitation beside PILCO, which is given a cost in place of demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from reproduction.figure7 import (
    GOAL,
    OURS,
    THEIR_TRIALS,
    our_runs,
    size,
    success_curves,
    success_results,
)
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

PILCO = "PILCO"
TRUST = 0.6  # of PILCO's predictions: on the seeds 100 to 102 it learned sooner than with 0.15


def pilco_task() -> Task:
    """PILCO's swing-up, with the trust by which it learns soonest."""
    task = load_experiment("double_pendulum_pilco")
    trusting = task.with_settings(**{"search.trust_threshold": TRUST})
    return replace(trusting, name=f"{task.name}_trusting")


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours, then PILCO's."""
    seeds, trials = size(quick, THEIR_TRIALS)
    return our_runs(root, quick) + [
        learning_run(root, pilco_task(), seed, trials) for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Experience at 95 % of each method, and success at the task's and the paper's experience."""
    curves = success_curves(folders, (OURS, PILCO))
    ours, pilco = curves.values()
    headline = {
        "ours_experience_to_95": ours.experience_to(GOAL),
        "ours_success_at_22.5s": ours.at(22.5),
        "ours_success_at_33s": ours.at(33.0),
        "pilco_experience_to_95": pilco.experience_to(GOAL),
        "pilco_success_at_33s": pilco.at(33.0),
        "pilco_final_success": pilco.at(float("inf")),
    }
    return success_results(curves, headline, "figure7a")


FIGURE7A = PaperExperiment(
    "figure7a", "success over experience: imitation and PILCO", needed_runs, results
)
