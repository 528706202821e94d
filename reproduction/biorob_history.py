"""The BioRob, whose motors are hidden, by a state that remembers, beside the state of the paper.

Each seed learns in four trials with both, so that each is a pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from reproduction.biorob import (
    QUICK_SEEDS,
    QUICK_TRIALS,
    SEEDS,
    TRIALS,
    headline_of,
    joint_degrees,
    measured,
)
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.sampling_frequency import Interval
from torch_pmil.runs.summaries import read_summary
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history

PLAIN, REMEMBERING = "joints now", "joints and torques before, too"


def remembering_biorob() -> Task:
    """The BioRob whose state holds the last reading and the last torques.

    Example:
        >>> task = remembering_biorob()
        >>> task.space.dim, task.make_dynamics().num_outputs
        (15, 6)
    """
    task = with_history(load_experiment("biorob"), past_entries=1, past_actions=1)
    return replace(task, name="biorob_history")


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The state of the paper, then the one that remembers."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    tasks = load_experiment("biorob"), remembering_biorob()
    return [learning_run(root, task, seed, trials) for task in tasks for seed in seeds]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """The main numbers of both, and by how much a seed's error is smaller with the past."""
    runs, half = [read_summary(folder) for folder in folders], len(folders) // 2
    ways = {PLAIN: runs[:half], REMEMBERING: runs[half:]}
    errors = [[joint_degrees(run["rms_error"]) for run in own] for own in ways.values()]
    without, remembering = torch.tensor(errors, dtype=torch.float64)
    interval = Interval.of(remembering - without)
    headline = {f"{name}_without": value for name, value in headline_of(ways[PLAIN]).items()}
    headline |= headline_of(ways[REMEMBERING]) | {
        "more_error_deg": interval.mean,
        "more_error_deg_half_interval": None if quick else interval.half_width,
    }
    details = {way: [measured(run) for run in own] for way, own in ways.items()}
    return Results(headline, {}, {"measured": details})


BIOROB_HISTORY = PaperExperiment(
    "biorob_history", "the BioRob by a state that remembers", needed_runs, results
)
