"""At which gains of its servos a robot must learn: the servo alone beside what learning reaches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

import torch
from torch import Tensor

from reproduction.double_pendulum_servo import with_servos
from reproduction.figure7 import experience_to_goal
from reproduction.plots.gains import plot_gains
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.runs.summaries import read_summary
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.trials import success_rate

STIFFNESSES = (3.0, 10.0, 30.0, 100.0)  # N·m/rad
DAMPINGS = (0.3, 1.0, 3.0, 10.0)  # N·m·s/rad
LEARNED = ((3.0, 0.3), (3.0, 1.0), (10.0, 1.0), (10.0, 3.0), (30.0, 3.0), (100.0, 10.0))
SEEDS, TRIALS = range(10), 8
STARTS, START_SEED = 20, 9_000_000  # no start that a run has seen


def with_gains(stiffness: float, damping: float) -> Task:
    """The double pendulum with servos of these gains, in N·m/rad and N·m·s/rad.

    Example:
        >>> with_gains(3.0, 0.3).name
        'double_pendulum_servo_kp3_kv0.3'
    """
    return with_servos(_name(stiffness, damping), stiffness=stiffness, damping=damping)


def success_alone(experiment: Task, still: bool = False) -> float:
    """Success rate of servos that follow the mean of the demonstrated angles, from fresh starts.

    At each step their targets are the angles of the next sample. Nothing is learned, and no state
    is measured.

    Args:
        experiment: says the robot.
        still: whether to begin at the mean start, at rest.
    """
    samples = experiment.horizon + 1
    angles = experiment.demonstrated_states.unflatten(0, (-1, samples))[..., ::2].mean(0)
    std = torch.zeros(4) if still else experiment.initial.std
    starts = 1 if still else STARTS
    env = experiment.make_env(num_envs=starts, seed=START_SEED, initial_std=std.tolist())
    targets = iter(angles[1:])

    def follow(state: Tensor) -> Tensor:
        return next(targets).expand(starts, -1)

    rollouts = env.rollout(experiment.horizon, follow)
    return success_rate(experiment.error(rollouts), experiment.tolerance)


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Some seeds at each of the gains that are learned with."""
    seeds, trials = (SEEDS[:1], 3) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, with_gains(*gains), seed, trials) for gains in LEARNED for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success of the servos alone over the gains, and the experience that learning took."""
    each = len(folders) // len(LEARNED)
    alone, at_rest = (
        torch.tensor(
            [[success_alone(with_gains(kp, kv), still) for kp in STIFFNESSES] for kv in DAMPINGS]
        )
        for still in (False, True)
    )
    summaries = [read_summary(folder) for folder in folders]
    runs = {gains: summaries[index * each :][:each] for index, gains in enumerate(LEARNED)}
    medians = {gains: median(map(experience_to_goal, of_gains)) for gains, of_gains in runs.items()}
    figure = plot_gains(STIFFNESSES, DAMPINGS, alone.numpy(), medians)
    headline: dict[str, float | None] = {
        **_by_gains("alone", alone),
        **_by_gains("alone_from_rest", at_rest),
    }
    for (kp, kv), seconds in medians.items():
        never = seconds == float("inf")
        headline[f"learned_experience_s_kp{kp:g}_kv{kv:g}"] = None if never else seconds
    details = {
        "starts": STARTS,
        "seeds": each,
        "success_rates": {
            _name(*gains): [run["saved_success_rate"] for run in of_gains]
            for gains, of_gains in runs.items()
        },
    }
    return Results(headline, {"servo_gains": figure}, details)


def _name(stiffness: float, damping: float) -> str:
    return f"kp{stiffness:g}_kv{damping:g}"


def _by_gains(name: str, rates: Tensor) -> dict[str, float]:
    return {
        f"{name}_{_name(kp, kv)}": rates[row, column].item()
        for row, kv in enumerate(DAMPINGS)
        for column, kp in enumerate(STIFFNESSES)
    }


SERVO_GAINS = PaperExperiment(
    "servo_gains", "servos alone and learning, over the gains", needed_runs, results
)
