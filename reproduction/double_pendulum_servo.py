"""The swing-up by position servos: experience, and other masses of the second link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import Any

from reproduction.baselines.cloning import FIRST_LINK
from reproduction.figure7 import GOAL, OUR_TRIALS, size, success_curves, success_results
from reproduction.learned import remeasured
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.envs import DoublePendulumServoEnv
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

LABEL = "imitation with position servos"
SECOND_LINKS = (0.15, 1.0)  # kg
VARIED_SEEDS, QUICK_SEEDS = range(10), range(1)
STARTS, START_SEED = 100, 8_000_000  # no start that a run has seen


def with_servos(name: str, **settings: Any) -> Task:
    """The double pendulum with other servos or links, which its first policy holds as well.

    Args:
        name: what the experiment's name ends with.
        settings: of :class:`DoublePendulumServoEnv`.

    Example:
        >>> with_servos("1kg", link_masses=(0.5, 1.0)).name
        'double_pendulum_servo_1kg'
    """
    experiment = load_experiment("double_pendulum_servo")
    make_env = partial(DoublePendulumServoEnv, **settings)
    return replace(
        experiment,
        name=f"{experiment.name}_{name}",
        make_env=make_env,
        holding_actions=make_env().holding_actions,
    )


def varied() -> dict[str, Task]:
    """The experiments with another second link, by name in the headline."""
    names = {f"{mass:g}kg": mass for mass in SECOND_LINKS}
    return {
        f"success_{name}": with_servos(name, link_masses=(FIRST_LINK, mass))
        for name, mass in names.items()
    }


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ten seeds of the plain robot, then some of each varied one."""
    seeds, trials = size(quick, OUR_TRIALS)
    plain = load_experiment("double_pendulum_servo")
    return [learning_run(root, plain, seed, trials) for seed in seeds] + [
        learning_run(root, experiment, seed, trials)
        for experiment in varied().values()
        for seed in (QUICK_SEEDS if quick else VARIED_SEEDS)
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience of the plain robot, and of the varied ones in the end."""
    seeds, _ = size(quick, OUR_TRIALS)
    own, others = folders[: len(seeds)], list(folders[len(seeds) :])
    plain, starts = load_experiment("double_pendulum_servo"), 20 if quick else STARTS
    curves = success_curves(own, [LABEL])
    runs = [remeasured(folder, plain, starts, START_SEED) for folder in own]
    headline: dict[str, float | None] = {
        "experience_to_95": curves[LABEL].experience_to(GOAL),
        "success_at_10s": curves[LABEL].at(10.0),
        "median_experience_s": median(run["experience_s"] for run in runs),
        "success": fmean(run["success_rate"] for run in runs),
    }
    each = len(others) // len(varied())
    for index, (name, experiment) in enumerate(varied().items()):
        of_robot = others[index * each : (index + 1) * each]
        measured = [remeasured(folder, experiment, starts, START_SEED) for folder in of_robot]
        headline[name] = fmean(run["success_rate"] for run in measured)
        runs += measured
    made = success_results(curves, headline, "double_pendulum_servo")
    return replace(made, details={**made.details, "starts": starts, "measured": runs})


DOUBLE_PENDULUM_SERVO = PaperExperiment(
    "double_pendulum_servo", "the swing-up by position servos", needed_runs, results
)
