"""A UR5e with six joints and a Panda with seven learn to carry a bottle and turn it.

They take joint targets and were led by hand. Beside them the servos alone, whose targets are the
mean demonstration, and PILCO's cost of the distance from the last pose.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from reproduction.arms import (
    PANDA,
    TOLERATED,
    UR5E,
    ArmPilco,
    Distance,
    arm_experiment,
    pilco_experiment,
    servo_alone,
    spread,
)
from reproduction.learned import Learned, load_learned
from reproduction.plots.photos import plot_photo_series
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run, tell_trial
from torch_pmil.envs.rollouts import states_of
from torch_pmil.plotting import Figure
from torch_pmil.runs.pictures import steps_of
from torch_pmil.runs.printing import tell
from torch_pmil.runs.training import train
from torch_pmil.tasks.task import MEASURED_STARTS, Task
from torch_pmil.trainer.trials import success_rate

SEEDS = {"ur5e": range(10), "panda": range(10), "pilco": range(10)}
QUICK_SEEDS = {"ur5e": range(1), "panda": range(1), "pilco": range(0)}
TRIALS = 3  # of 3 s, after a first motion of 3 s
START_SEED = 7_000_000  # no start that a run has seen
PHOTOGRAPHED = (0.0, 0.75, 1.5, 2.0, 2.95)  # s
SHOWN = np.s_[60:400, 130:610]  # of a picture, with the arm


def experiments() -> dict[str, Task]:
    """The imitations, and PILCO on the UR5e."""
    return {
        "ur5e": arm_experiment(UR5E),
        "panda": arm_experiment(PANDA),
        "pilco": pilco_experiment(UR5E),
    }


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """All seeds of the UR5e, then of the Panda, then of PILCO; the first of each is drawn."""
    seeds = QUICK_SEEDS if quick else SEEDS
    return [
        _drawn_run(root, experiment, seed)
        if seed == 0
        else learning_run(root, experiment, seed, TRIALS)
        for name, experiment in experiments().items()
        for seed in seeds[name]
    ]


def _drawn_run(root: Path, experiment: Task, seed: int) -> Run:
    """A run that leaves its figures, video and report too."""
    run = learning_run(root, experiment, seed, TRIALS)
    return Run(run.out, partial(_learn_and_tell, experiment=experiment, seed=seed))


def _learn_and_tell(out: Path, command: str, experiment: Task, seed: int) -> None:
    told = partial(tell_trial, out)
    result = train(
        experiment, seed, TRIALS, out, command, progress_bar=False, on_trial=told, resume=True
    )
    for failure in tell(steps_of(experiment, result, out)):
        warnings.warn(f"{out}: {failure}", RuntimeWarning, stacklevel=1)


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Seeds that came near enough, how near, after how much experience; the first is drawn."""
    tasks, seeds = experiments(), QUICK_SEEDS if quick else SEEDS
    rest, measured = iter(folders), dict[str, list[dict[str, Any]]]()
    for name, task in tasks.items():
        shown = task.imitation if isinstance(task, ArmPilco) else task
        measured[name] = [measured_run(load_learned(next(rest), task), shown) for _ in seeds[name]]
    servos = {
        f"servo_alone_ratio_{arm.name}": ratio_of(
            servo_alone(tasks[arm.name], MEASURED_STARTS, START_SEED), tasks[arm.name]
        )
        for arm in (UR5E, PANDA)
    }
    headline = headline_of(measured["ur5e"]) | {
        f"panda_{name}": value for name, value in headline_of(measured["panda"]).items()
    }
    if measured["pilco"]:
        headline["pilco_median_ratio"] = median(run["ratio"] for run in measured["pilco"])
    degrees = {
        f"spread_deg_{arm.name}": math.degrees(spread(tasks[arm.name].demonstrations))
        for arm in (UR5E, PANDA)
    }
    details = {"tolerated_ratio": TOLERATED, "starts": MEASURED_STARTS, "measured": measured}
    figures = drawn(load_learned(folders[0], tasks["ur5e"]), tasks["ur5e"])
    return Results(headline | servos | degrees, figures, details)


def measured_run(learned: Learned, task: Task) -> dict[str, Any]:
    """The main numbers of a run, measured from fresh starts that it has not seen.

    Args:
        learned: what the run learned.
        task: whose demonstrations its rollouts are compared with.
    """
    executed = states_of(learned.rollouts(task, MEASURED_STARTS, START_SEED))
    distances, summary = Distance(task.demonstrations)(executed), learned.summary
    kept = ("seed", "experience_s", "wall_seconds", "stop_reason", "two_sigma_coverage")
    return {name: summary[name] for name in kept} | {
        "trials": len(summary["trials"]),
        "ratio": ratio_of(executed, task),
        "success_rate": success_rate(distances, task.tolerance),
    }


def ratio_of(executed: Tensor, task: Task) -> float:
    """Rms distance from the mean demonstration of all rollouts, in the demonstrations' spread."""
    distances = Distance(task.demonstrations)(executed)
    return distances.square().mean().sqrt().item() / spread(task.demonstrations)


def headline_of(runs: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """The main numbers of an arm's runs."""
    return {
        "seeds_solved": sum(run["ratio"] <= TOLERATED for run in runs),
        "seeds": len(runs),
        "median_ratio": median(run["ratio"] for run in runs),
        "worst_ratio": max(run["ratio"] for run in runs),
        "median_experience_s": median(run["experience_s"] for run in runs),
        "max_experience_s": max(run["experience_s"] for run in runs),
        "max_wall_s": max(run["wall_seconds"] for run in runs),
        "two_sigma_coverage": median(run["two_sigma_coverage"] for run in runs),
    }


def drawn(learned: Learned, task: Task) -> dict[str, Figure]:
    """Pictures of the mean demonstration above those of a rollout, if OpenGL is available."""
    rollouts = learned.rollouts(task, MEASURED_STARTS, START_SEED)
    try:
        return {f"{task.name}_pictures": photo_series(rollouts[0], task)}
    except RuntimeError as error:
        warnings.warn(f"there are no pictures: {error}", RuntimeWarning, stacklevel=1)
        return {}


def photo_series(rollout: TensorDictBase, task: Task) -> Figure:
    """The mean demonstration above a rollout (T,), in pictures of the simulation.

    Raises:
        RuntimeError: OpenGL is not available.
    """
    shape = task.demonstrations.positions.shape[:2]
    motions = {
        "demonstrated": task.demonstrated_states.unflatten(0, shape).mean(0),
        "learned": states_of(rollout),
    }
    steps = [round(time / task.time_step) for time in PHOTOGRAPHED]
    env = task.make_env(seed=0)
    try:
        pictures = {
            name: [env.render(states[step])[SHOWN] for step in steps]
            for name, states in motions.items()
        }
    finally:
        env.close()
    return plot_photo_series(pictures, PHOTOGRAPHED)


UR5E_CARRIES = PaperExperiment(
    "ur5e", "arms of six and seven joints carry a bottle, by joint targets", needed_runs, results
)
