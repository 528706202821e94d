"""Robots of other masses than the demonstrator's: imitation, cloning, exact tracking.

This is Section 5.1.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from torch import Tensor

from reproduction.baselines.cloning import (
    DEMONSTRATED,
    FIRST_LINK,
    clone_double_pendulum,
    peak_tracking_torques,
    record_pairs,
)
from reproduction.learned import load_learned, measured_success, remeasured
from reproduction.plots.success import plot_success_over_mass
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions
from torch_pmil.envs.rollouts import states_of
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SECOND_LINKS = (0.15, 0.3, 0.4, 0.5, 0.57, 0.65, 0.8, 1.0)  # kg, second link of the robots
SEEDS = range(10)  # of our runs on each robot
TRIALS = 13
CLONED = range(10)  # seeds of the cloned demonstrations; those of 0 come with the package
STARTS = 100
START_SEED = 5_000_000  # no start that a run has seen


def with_second_link(mass: float) -> Task:
    """The double pendulum with a second link of that mass in kg.

    It learns from the demonstrations that come with the package.

    Example:
        >>> with_second_link(0.3).name, with_second_link(DEMONSTRATED).name
        ('double_pendulum_0.3kg', 'double_pendulum')
    """
    experiment = load_experiment("double_pendulum")
    if mass == DEMONSTRATED:
        return experiment
    return replace(
        experiment,
        name=f"double_pendulum_{mass:g}kg",
        make_env=partial(DoublePendulumEnv, (FIRST_LINK, mass)),
    )


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours on each robot; that of the demonstrator's mass is the plain double pendulum."""
    seeds, trials = (SEEDS[:1], 3) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, with_second_link(mass), seed, trials)
        for mass in SECOND_LINKS
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over the mass, of our runs and of cloned policies, and peak torques of tracking."""
    sets, starts = (CLONED[:2], 20) if quick else (CLONED, STARTS)
    robots = [with_second_link(mass) for mass in SECOND_LINKS]
    runs_each = len(folders) // len(robots)
    learned_on = [robot for robot in robots for _ in range(runs_each)]
    runs = [
        remeasured(folder, robot, starts, START_SEED)
        for robot, folder in zip(learned_on, folders, strict=True)
    ]
    ours = np.reshape([run["success_rate"] for run in runs], (len(robots), runs_each)).T
    distances = [
        departure(states_of(load_learned(run, robot).rollouts(robot, starts, START_SEED)), robot)
        for robot, run in zip(learned_on, folders, strict=True)
    ]
    departures = np.reshape(distances, ours.T.shape)
    pairs = list(record_pairs(sets))
    cloning = cloned_success([clone_double_pendulum(*pair) for pair in pairs], robots, starts)
    peaks = peak_tracking_torques(*pairs[0], SECOND_LINKS).numpy()
    limit = robots[0].actions.high.max().item()
    difference = link_positions(pairs[0][0]) - shipped_demonstrations("double_pendulum").positions
    headline = {
        **_by_mass("ours_success", ours.mean(0)),
        **_by_mass("ours_departure_m", departures.mean(1)),
        **_by_mass("cloning_success", cloning.mean(0)),
        **_by_mass("peak_torque", peaks.max(0)),
        "torque_limit": limit,
        "difference_from_shipped_demonstrations_m": difference.abs().max().item(),
    }
    details = {
        "masses": list(SECOND_LINKS),
        "starts": starts,
        "cloned_seeds": list(sets),
        "ours": runs,
        "ours_departures_m": departures.tolist(),
        "cloning_success_rates": cloning.tolist(),
        "peak_torques": peaks.tolist(),
    }
    figure = plot_success_over_mass(
        SECOND_LINKS, {"ours": ours, "behavioural cloning": cloning}, peaks, limit, DEMONSTRATED
    )
    return Results(headline, {"masses": figure}, details)


def cloned_success(
    clones: Sequence[StatePolicy], robots: Sequence[Task], starts: int
) -> np.ndarray:
    """Success rates (clones, robots) of cloned policies."""
    return np.array(
        [
            [measured_success(clone, robot, starts, START_SEED) for robot in robots]
            for clone in clones
        ]
    )


def departure(states: Tensor, robot: Task) -> float:
    """Root mean square distance (m) of the two link ends from the demonstrated mean.

    It is over rollouts x_0..x_T (N, T + 1, 4) and steps 1..T.

    Example:
        >>> robot = with_second_link(DEMONSTRATED)
        >>> 0 < departure(robot.demonstrated_states.unflatten(0, (5, 26)), robot) < 0.1
        True
    """
    difference = robot.space.observe(states[:, 1:]) - robot.demonstrated.mean
    return difference.unflatten(-1, (2, 2)).square().sum(-1).mean().sqrt().item()


def _by_mass(name: str, values: np.ndarray) -> dict[str, float]:
    return {
        f"{name}_{mass:g}kg": value
        for mass, value in zip(SECOND_LINKS, values.tolist(), strict=True)
    }


MASSES = PaperExperiment(
    "masses", "ours and behavioural cloning on robots of other masses", needed_runs, results
)
