"""Ablation: the double pendulum with one choice of the method at a time made otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from reproduction.plots.variants import plot_variants
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.soak.comparison import paired
from torch_pmil.control.known_part import KnownPart
from torch_pmil.runs.summaries import read_summary, success_over_experience
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.method import SURE, ModelSettings
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEEDS, TRIALS = range(10), 8
QUICK_SEEDS, QUICK_TRIALS = range(1), 2
SOON = 10.0, 12.5  # s of experience
AT_ONCE = 2  # times the iterations that each horizon has, where there is only one
MEAN_COST = 12  # an evaluation of the mean alone costs a twelfth of one of the loss, or less
LABELS = {
    "ours": "ours",
    "no_samples": "no search on samples",
    "matched": "horizon by match, no samples",
    "no_growing_horizon": "whole horizon at once",
    "no_mean_start": "no runs on the mean",
    "plain_angles": "plain angles",
    "successors": "successors as targets",
    "all_entries": "positions learned too",
    "tied_lengthscales": "tied lengthscales",
}


@dataclass(frozen=True, eq=False)
class Variation(Task):
    """A task whose model may learn the next states, in place of the changes of the state."""

    successors: bool = False

    @property
    def settings(self) -> dict[str, object]:
        """Numbers that a run depends on."""
        return super().settings | {
            "successors": self.successors,
            "angles": list(self.space.angles),
        }

    @property
    def _known_part(self) -> KnownPart:
        return KnownPart.of_successors(self.space.dim) if self.successors else super()._known_part


def variations() -> dict[str, Variation]:
    """The double pendulum as it is, and with each choice made otherwise.

    Iterations that a choice would save go elsewhere.

    Example:
        >>> variations()["no_samples"].method.search.sample_steps
        0
    """
    task = load_experiment("double_pendulum")
    ours = Variation(**{entry.name: getattr(task, entry.name) for entry in fields(task)})
    method = task.method
    policy, search = method.policy, method.search
    at_once = replace(
        search,
        first_horizon=1.0,
        mean_iterations=AT_ONCE * search.mean_iterations,
        stage_iterations=AT_ONCE * search.stage_iterations,
    )
    no_mean_start = replace(
        search,
        mean_iterations=0,
        stage_iterations=search.stage_iterations + search.mean_iterations // MEAN_COST,
    )
    all_entries = {"method": replace(method, model=ModelSettings())}
    tied = replace(method.model, tied_lengthscales=True)
    changes: dict[str, dict[str, Any]] = {
        "ours": {},
        "no_samples": {"method": replace(method, search=SURE)},
        "matched": {"method": replace(method, search=SearchSettings())},
        "no_growing_horizon": {"method": replace(method, search=at_once)},
        "no_mean_start": {"method": replace(method, search=no_mean_start)},
        "plain_angles": {
            "space": replace(task.space, angles=()),
            "method": replace(method, policy=replace(policy, least_widths=None)),
        },
        "successors": {"successors": True, **all_entries},
        "all_entries": all_entries,
        "tied_lengthscales": {"method": replace(method, model=tied)},
    }
    return {
        name: replace(ours, name=f"double_pendulum_ablation_{name}", **change)
        for name, change in changes.items()
    }


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Each variation with each seed."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, experiment, seed, trials)
        for experiment in variations().values()
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success of the saved policies, and experience up to the first own rollout that succeeded.

    Also the mean success after so few seconds that variations differ (``SOON``).
    """
    runs, each = [read_summary(folder) for folder in folders], len(folders) // len(LABELS)
    found = results_of_variants(LABELS, "ablation", runs)
    soon: dict[str, float | None] = {}
    for number, variant in enumerate(LABELS):
        curve = success_over_experience(runs[number * each : (number + 1) * each])
        soon |= {f"{variant}_success_{time:g}s": curve.at(time) for time in SOON}
    return replace(found, headline={**found.headline, **soon})


def results_of_variants(labels: Mapping[str, str], name: str, runs: Sequence[dict]) -> Results:
    """Success and experience of variants with equally many runs, and differences from the first.

    Args:
        labels: of the variants in the figure, by their names.
        name: of the figure.
        runs: summaries, variant by variant, each with the same seeds.
    """
    outcomes = [success_and_experience(run) for run in runs]
    rates, seconds, succeeded = (
        np.array(values).reshape(len(labels), -1) for values in zip(*outcomes, strict=True)
    )
    numbers = {
        "success": rates.mean(1).tolist(),
        "first_success_s": seconds.mean(1).tolist(),
        "runs_with_success": succeeded.sum(1).tolist(),
    }
    headline = {
        f"{variant}_{number}": value
        for number, values in numbers.items()
        for variant, value in zip(labels, values, strict=True)
    }
    figure = plot_variants(list(labels.values()), rates, np.where(succeeded, seconds, np.inf))
    details = {
        "variations": list(labels),
        "success": rates.tolist(),
        "first_success_s": seconds.tolist(),
        "more_success": _less_first(list(labels), rates.tolist()),
        "more_first_success_s": _less_first(list(labels), seconds.tolist()),
    }
    return Results(headline, {name: figure}, details)


def _less_first(
    labels: Sequence[str], values: Sequence[Sequence[float]]
) -> dict[str, dict[str, float | None]]:
    """A quantity of each variant less that of the first, seed by seed, with the intervals."""
    first, *others = values
    return {
        label: paired(list(zip(theirs, first, strict=True)))
        for label, theirs in zip(labels[1:], others, strict=True)
    }


def success_and_experience(summary: dict) -> tuple[float, float, bool]:
    """Success rate, seconds of experience up to the first success, and whether there was one.

    The rate is that of the run's saved policy; a success is an own rollout that succeeded.

    Without success they are all its seconds: no fewer would have done.
    """
    successes = [trial["experience_s"] for trial in summary["trials"] if trial["own_success"]]
    seconds = successes[0] if successes else summary["experience_s"]
    return summary["saved_success_rate"], seconds, bool(successes)


ABLATION = PaperExperiment("ablation", "what each choice of the method earns", needed_runs, results)
