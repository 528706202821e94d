"""Ours beside its peers: learners from states alone, on the same robots with the same experience.

All see the same exploration, starts and demonstrations, act at the same rate, and are measured from
the same fresh starts. What is compared is the success rate with so many seconds of experience.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from reproduction.baselines.known_peers import PEERS
from reproduction.baselines.peer import Peer
from reproduction.baselines.peer_run import peer_run
from reproduction.figure7 import GOAL, OURS, SEEDS, success_curves, success_results
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.soak.comparison import paired
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.runs.summaries import SuccessCurve
from torch_pmil.experiments.tasks.experiment import Experiment

TASKS = {  # with the peers that learn them
    "double_pendulum": ("gp_tracker", "ensemble_cem", "bco"),
    "pendubot": ("gp_tracker",),
}
TIMES = (12.5, 25.0, 50.0)  # s of experience
QUICK_SEEDS, QUICK_END = range(2), 5.0

Learner = Callable[[Path, Experiment, int, int], Run]


def methods(task: str) -> dict[str, tuple[str, Learner]]:
    """Name and runs of each method that learns a task, by its name in the figures.

    Example:
        >>> [name for name, _ in methods("pendubot").values()]
        ['ours', 'gp_tracker']
    """
    peers = {
        PEERS[name].label: (name, partial(_peer_run, peer_class=PEERS[name]))
        for name in TASKS[task]
    }
    return {OURS: ("ours", learning_run), **peers}


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Those of each task, by each method, of each seed."""
    seeds, end = (QUICK_SEEDS, QUICK_END) if quick else (SEEDS, TIMES[-1])
    experiments = {task: load_experiment(task) for task in TASKS}
    return [
        learn(root, experiment, seed, trials_until(end, experiment))
        for task, experiment in experiments.items()
        for _, learn in methods(task).values()
        for seed in seeds
    ]


def trials_until(end: float, experiment: Experiment) -> int:
    """Trials of which the last one learns from ``end`` seconds of experience, or a little less.

    Example:
        >>> trials_until(50.0, load_experiment("double_pendulum"))
        20
    """
    period, exploration = experiment.demonstrations.time_step, experiment.exploration
    steps = round(end / period) - exploration.rollouts * exploration.steps
    return 1 + max(0, steps // experiment.horizon)


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience of each method on each task, and by how much ours is ahead."""
    seeds = len(QUICK_SEEDS if quick else SEEDS)
    headline: dict[str, float | None] = {"seeds": seeds}
    figures: dict[str, Figure] = {}
    details: dict[str, object] = {}
    left = list(folders)
    for task in TASKS:
        known = methods(task)
        count = seeds * len(known)
        own, left = left[:count], left[count:]
        curves = success_curves(own, list(known))
        headline |= {
            f"{quantity}_{task}_{name}": value
            for (name, _), curve in zip(known.values(), curves.values(), strict=True)
            for quantity, value in _numbers(curve).items()
        }
        made = success_results(curves, {}, f"peers_{task}")
        figures |= made.figures
        details[task] = {**made.details, "ahead": _ahead(curves)}
    return Results(headline, figures, details)


def _peer_run(
    root: Path, experiment: Experiment, seed: int, trials: int, peer_class: type[Peer]
) -> Run:
    return peer_run(root, experiment, peer_class, seed, trials)


def _numbers(curve: SuccessCurve) -> dict[str, float | None]:
    """Success at ``TIMES`` with its 95 % interval, and the experience to 95 %."""
    found: dict[str, float | None] = {"experience_to_95": curve.experience_to(GOAL)}
    for time in TIMES:
        column = curve.column(time)
        found[f"success_{time:g}s"] = curve.mean[column].item()
        found[f"lower_{time:g}s"] = curve.lower[column].item()
        found[f"upper_{time:g}s"] = curve.upper[column].item()
    return found


def _ahead(curves: Mapping[str, SuccessCurve]) -> dict[str, dict[str, object]]:
    """Success of ours less that of each peer on the same seeds, with the bootstrap's intervals."""
    ours, *peers = curves
    rates = {
        (label, time): curve.rates[:, curve.column(time)].tolist()
        for label, curve in curves.items()
        for time in TIMES
    }
    return {
        peer: {
            f"{time:g}s": paired(list(zip(rates[ours, time], rates[peer, time], strict=True)))
            for time in TIMES
        }
        for peer in peers
    }


PEERS_STUDY = PaperExperiment(
    "peers", "ours beside other learners from states alone", needed_runs, results
)
