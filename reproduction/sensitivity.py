"""Sensitivity: the double pendulum with each setting halved and doubled, on held-out seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from reproduction.ablation import results_of_variants
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.runs.summaries import read_summary
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEEDS, TRIALS = range(10), 10
QUICK_SEEDS, QUICK_TRIALS = range(1), 2
OURS = "ours"
SETTINGS = (
    "noise_std",
    "num_centres",
    "initial_weight_std",
    "input_scale",
    "random_action",
    "search.sample_steps",
    "search.mean_iterations",
    "search.stage_iterations",
    "search.final_iterations",
    "search.first_horizon",
    "search.horizon_step",
    "search.trust_threshold",
)
FACTORS = {"halved": 0.5, "doubled": 2}


def variants() -> dict[str, Task]:
    """The double pendulum as it is, and with each setting halved and doubled, by their names.

    Example:
        >>> tasks = variants()
        >>> tasks["search.first_horizon halved"].method.search.first_horizon, len(tasks)
        (0.1, 25)
    """
    task = load_experiment("double_pendulum")
    known: dict[str, Any] = task.adjustable
    changed = {
        f"{setting} {word}": task.with_settings(
            **{setting: type(known[setting])(factor * known[setting])}
        )
        for setting in SETTINGS
        for word, factor in FACTORS.items()
    }
    named = {
        label: replace(variant, name=f"{task.name}_{label.replace(' ', '_')}")
        for label, variant in changed.items()
    }
    return {OURS: task, **named}


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Each variant with each seed."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root / "sensitivity", experiment, seed, trials)
        for experiment in variants().values()
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success and experience of each variant, and both less those of ours, seed by seed."""
    labels = {label.replace(" ", "_"): label for label in variants()}
    found = results_of_variants(labels, "sensitivity", list(map(read_summary, folders)))
    seeds = list(QUICK_SEEDS if quick else SEEDS)
    return replace(found, details={**found.details, "seeds": seeds})


SENSITIVITY = PaperExperiment(
    "sensitivity", "what each setting does, halved and doubled", needed_runs, results
)
