"""The measures behind the diagnosis' thresholds, of runs that learned and runs that did not.

    python -m benchmarks.diagnosis

reads every finished run with the present sources, lets its policy run from fresh starts, and
writes the measures of each run. Of the runs that learned it writes the worst value of each measure,
and the share that lies beyond its threshold. Runs of other experiments than the shipped ones, their
ablation and their varied robots are counted as left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean

import torch

from benchmarks.command_line import add_json, source_of, write_summary
from reproduction.ablation import variations
from reproduction.handwriting import TASKS as WRITERS, written
from reproduction.learned import load_learned
from reproduction.masses import SECOND_LINKS, with_second_link
from reproduction.reproduction import root_of_runs
from reproduction.robustness import varied_experiments
from torch_pmil.model.calibration import standardised_residuals, two_sigma_coverage
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.runs.diagnosis.after_a_run import known_steps, likely_reasons
from torch_pmil.runs.diagnosis.measures import (
    COVERED,
    FEWEST_STEPS,
    FOLLOWED,
    LEARNED,
    MISMATCH,
    MOVED,
    SATURATED,
    UNKNOWN,
    covered_fraction,
    moved_fraction,
    saturated_fraction,
)
from torch_pmil.runs.summaries import RunError, read_summary
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.trials import success_rate

STARTS, START_SEED = 20, 7_000_000  # no start that a run has seen
# thresholds of the measures that are bad when they are small, and of those that are when large
SMALLEST = {"covered": COVERED, "followed": FOLLOWED, "moved": MOVED}
LARGEST = {"unknown": UNKNOWN, "saturated": SATURATED, "mismatch": MISMATCH}


def known_experiments() -> dict[str, Task]:
    """All experiments with demonstrations of which runs may be, except handwriting."""
    shipped = [load_experiment(name) for name in EXPERIMENTS if "handwriting" not in name]
    imitations = [experiment for experiment in shipped if not isinstance(experiment, CostTask)]
    varied = [
        *varied_experiments().values(),
        *variations().values(),
        *map(with_second_link, SECOND_LINKS),
    ]
    return {experiment.name: experiment for experiment in [*varied, *imitations]}


def experiment_of(name: str, known: dict[str, Task]) -> Task | None:
    """The experiment of a run; None if it is not among those that are known here."""
    if name.startswith("handwriting_") and name not in known:
        _, shape, robot = name.split("_", 2)
        if robot in WRITERS:
            known[name] = written(shape, robot)
    return known.get(name)


@torch.no_grad()
def measured(folder: Path, experiment: Task) -> dict[str, object]:
    """Measures of the saved policy of a run, the worst over its targets, and its diagnosis."""
    learned = load_learned(folder, experiment)
    loss = experiment.make_loss(learned.policy.policy, learned.dynamics)
    rollouts = learned.rollouts(experiment, STARTS, START_SEED)
    errors = experiment.error(rollouts)
    outcomes = experiment.outcomes(loss.predict_states(experiment.initial), rollouts, errors)
    of_each = [of_outcome(experiment, learned.dynamics, outcome) for outcome in outcomes]
    horizons = [trial["horizon"] for trial in learned.summary["trials"]]
    largest_loss = loss.step_loss_for_trust(experiment.initial).amax().item()
    reasons = likely_reasons(experiment, loss, outcomes, horizons, [])
    return {
        "run": str(folder),
        "experiment": experiment.name,
        "success_rate": success_rate(errors, experiment.tolerance),
        **{name: worst(name, of_each) for name in of_each[0]},
        "mismatch": largest_loss / experiment.method.search.trust_threshold,
        "causes": [reason.cause for reason in reasons],
    }


def worst(name: str, measures: Sequence[Mapping]) -> float:
    """The worst value of a measure among several."""
    return (min if name in SMALLEST else max)(each[name] for each in measures)


def beyond(name: str, measures: Sequence[Mapping]) -> float:
    """Share of several values of a measure that lie beyond its threshold."""
    if name in SMALLEST:
        return fmean(each[name] < SMALLEST[name] for each in measures)
    return fmean(each[name] > LARGEST[name] for each in measures)


def of_outcome(experiment: Task, dynamics: GPDynamics, outcome: Outcome) -> dict[str, float]:
    """Measures of one target."""
    actions = outcome.rollouts["action"]
    residuals = standardised_residuals(dynamics, experiment.space, outcome.executed, actions)
    known = known_steps(experiment, dynamics, outcome)
    noise_std = torch.as_tensor(experiment.noise_std, dtype=torch.float64)
    executed = experiment.space.observe(outcome.executed)
    covered = 1.0
    if known.sum() >= FEWEST_STEPS:
        covered = covered_fraction(residuals[known]).amin().item()
    return {
        "covered": covered,
        "followed": two_sigma_coverage(outcome.predicted, outcome.executed),
        "unknown": (~known).double().mean().item(),
        "saturated": saturated_fraction(actions, experiment.actions).amax().item(),
        "moved": moved_fraction(executed, outcome.demonstrations.positions, noise_std),
    }


def main() -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "diagnosis")
    arguments = parser.parse_args()
    source = source_of("diagnosis")
    torch.set_num_threads(1)
    root, known, runs, left_out = root_of_runs(), known_experiments(), [], 0
    for path in sorted(root.rglob("summary.json")):
        if "quick" in path.relative_to(root).parts:
            continue
        try:
            experiment = experiment_of(read_summary(path.parent)["experiment"], known)
        except RunError:  # what a study left beside its runs
            experiment = None
        if experiment is None:
            left_out += 1
            continue
        runs.append(measured(path.parent, experiment))
        print(runs[-1], flush=True)
    learned = [run for run in runs if run["success_rate"] >= LEARNED]
    names = *SMALLEST, *LARGEST
    numbers = {"runs_that_learned": len(learned), "other_runs": len(runs) - len(learned)}
    headline = {
        **numbers,
        "left_out": left_out,
        **{name: worst(name, learned) for name in names},
        **{f"{name}_beyond": beyond(name, learned) for name in names},
    }
    found = {**source, "starts": STARTS, "headline": headline, "runs": runs}
    write_summary(arguments.json, found)
    print(headline)


if __name__ == "__main__":
    main()
