"""The double pendulum whose model learns velocities alone, beside the one that learns all entries.

The positions follow from the velocities by a rule that is fitted. The seeds are the same, so that
each is a pair: of experience, of success, and of the CPU time of an evaluation of the saved policy
by the model of all experience, in one thread.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median
from typing import Any

import torch

from reproduction.figure7 import (
    GOAL,
    OUR_TRIALS,
    OURS,
    our_runs,
    size,
    success_curves,
    success_results,
)
from reproduction.learned import load_learned, measured_anew
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.sampling_frequency import Interval
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

ALONE = "velocities alone"
STARTS, START_SEED = 100, 9_000_000  # no start that a run has seen
REPEATS = 7  # evaluations


def velocities_alone() -> Task:
    """The double pendulum whose model learns velocities alone.

    Example:
        >>> velocities_alone().make_dynamics().num_outputs
        2
    """
    task = load_experiment("double_pendulum")
    return replace(task.with_settings(velocities_alone=True), name="double_pendulum_velocities")


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """All entries, then velocities alone."""
    seeds, trials = size(quick, OUR_TRIALS)
    return our_runs(root, quick) + [
        learning_run(root, velocities_alone(), seed, trials) for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Experience and success of both, and what each seed differs by."""
    curves, half = success_curves(folders, (OURS, ALONE)), len(folders) // 2
    starts = 20 if quick else STARTS
    ways = {
        OURS: (load_experiment("double_pendulum"), folders[:half]),
        ALONE: (velocities_alone(), folders[half:]),
    }
    measured = {
        way: [_measured(folder, task, starts) for folder in own]
        for way, (task, own) in ways.items()
    }
    pairs = list(zip(measured[OURS], measured[ALONE], strict=True))
    more = [alone["experience_s"] - ours["experience_s"] for ours, alone in pairs]
    interval = Interval.of(torch.tensor(more, dtype=torch.float64))
    headline: dict[str, float | None] = {
        "experience_to_95": curves[OURS].experience_to(GOAL),
        "experience_to_95_velocities_alone": curves[ALONE].experience_to(GOAL),
        "success": fmean(run["success_rate"] for run in measured[OURS]),
        "success_velocities_alone": fmean(run["success_rate"] for run in measured[ALONE]),
        "more_experience_s": interval.mean,
        "more_experience_s_half_interval": None if quick else interval.half_width,
        "evaluation_time_ratio": median(
            alone["evaluation_cpu_s"] / ours["evaluation_cpu_s"] for ours, alone in pairs
        ),
    }
    made = success_results(curves, headline, "velocities")
    return replace(made, details={**made.details, "starts": starts, "measured": measured})


def _measured(folder: Path, task: Task, starts: int) -> dict[str, Any]:
    """The main numbers of a run, and the least CPU time of some evaluations of its policy."""
    learned = load_learned(folder, task)
    policy = learned.policy.policy.requires_grad_(True)
    loss, parameters = task.make_loss(policy, learned.dynamics), list(policy.parameters())
    seconds, threads = [], torch.get_num_threads()
    torch.set_num_threads(1)
    for _ in range(REPEATS):
        begun = time.process_time()
        torch.autograd.grad(loss.per_step(task.initial).sum(), parameters)
        seconds.append(time.process_time() - begun)
    torch.set_num_threads(threads)
    own = measured_anew(learned, task, starts, START_SEED)
    return own | {
        "transitions": len(learned.dynamics.train_inputs),
        "evaluation_cpu_s": min(seconds),
    }


VELOCITIES = PaperExperiment(
    "velocities", "the double pendulum, of which velocities alone are learned", needed_runs, results
)
