"""Robustness: wider starts, noisy sensors, fewer or more demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from reproduction.baselines.cloning import record_pairs
from reproduction.learned import remeasured
from reproduction.plots.success import plot_success_over_settings
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.demonstrations import Demonstrations, shipped_demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEEDS = range(10)
TRIALS = 13
STARTS = 100
START_SEED = 6_000_000  # no start that a run has seen
PLAIN_START_STD = 0.05  # rad
# 1/s: noise of the velocities, for one of the angles; differences of angles 0.1 s apart have
# sqrt(2) / 0.1 s of it
VELOCITY_NOISE = 10.0
RECORDED_SEED = 1  # of the demonstrations beyond the five that come with the package, which have 0


def with_start_std(std: float) -> Task:
    """The double pendulum with starts that vary by ``std`` (rad); the learner knows p(x_0).

    Velocities vary in proportion.
    """
    experiment = load_experiment("double_pendulum")
    spread = experiment.initial.std * std / PLAIN_START_STD
    return replace(
        experiment,
        make_env=partial(DoublePendulumEnv, initial_std=spread.tolist()),
        initial=Gaussian(experiment.initial.mean, torch.diag(spread**2)),
    )


def with_noise(std: float, name: str = "double_pendulum") -> Task:
    """The robot of that name with sensor noise of ``std`` (rad) in the angles.

    The learner's p(x_0) is the sensors' view of the start.

    The states that the policy sees and the model learns from are noisy. So are those by which a run
    judges its own rollouts.
    """
    experiment = load_experiment(name)
    noise = noise_of(std, experiment.space.names)
    return replace(
        experiment,
        make_env=partial(experiment.make_env, observation_std=noise.tolist()),
        initial=experiment.initial.add_noise(noise**2),
    )


def noise_of(std: float, names: Sequence[str]) -> Tensor:
    """Standard deviations of the readings of these names, of ``std`` (rad) in the angles, (D,).

    Example:
        >>> noise_of(0.05, ("q1", "dq1", "q2", "dq2")).tolist()
        [0.05, 0.5, 0.05, 0.5]
    """
    factors = [VELOCITY_NOISE if name.startswith("d") else 1.0 for name in names]
    return std * torch.tensor(factors, dtype=torch.float64)


def with_demonstrations(count: int) -> Task:
    """The double pendulum with the first ``count`` of ten demonstrations.

    Five of them come with the package.
    """
    demonstrations = ten_demonstrations()
    return load_experiment(
        "double_pendulum", replace(demonstrations, positions=demonstrations.positions[:count])
    )


@cache
def ten_demonstrations() -> Demonstrations:
    """The five demonstrations that come with the package, and five more of the same teacher."""
    shipped = shipped_demonstrations("double_pendulum")
    ((states, _),) = record_pairs([RECORDED_SEED])
    return replace(shipped, positions=torch.cat([shipped.positions, link_positions(states)]))


@dataclass(frozen=True)
class Factor:
    """One setting that is varied.

    Args:
        name: in the summary and in the names of runs.
        label: on its axis.
        unit: of the levels.
        levels: that it takes.
        plain: the level of the plain double pendulum.
        vary: the experiment at another level.
    """

    name: str
    label: str
    unit: str
    levels: tuple[float, ...]
    plain: float
    vary: Callable[..., Task]

    def names(self) -> list[str]:
        """Names of the levels, as the summary has them."""
        return [f"{self.name}_{level:g}{self.unit}" for level in self.levels]

    def experiments(self) -> list[Task]:
        """The experiment at each level."""
        plain = load_experiment("double_pendulum")
        return [
            plain if level == self.plain else replace(self.vary(level), name=f"{plain.name}_{name}")
            for level, name in zip(self.levels, self.names(), strict=True)
        ]


FACTORS = (
    Factor(
        "start",
        "spread of the start, sd (rad)",
        "rad",
        (0.05, 0.1, 0.2),
        PLAIN_START_STD,
        with_start_std,
    ),
    Factor(
        "noise", "noise of the sensors, sd (rad)", "rad", (0.0, 0.01, 0.02, 0.05), 0.0, with_noise
    ),
    Factor("demonstrations", "demonstrations", "", (2, 3, 5, 10), 5, with_demonstrations),
)


def varied_experiments() -> dict[str, Task]:
    """All experiments of all factors by name, the plain one once."""
    return {
        experiment.name: experiment for factor in FACTORS for experiment in factor.experiments()
    }


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours at each level of each factor; the plain double pendulum is learned once for all."""
    seeds, trials = (SEEDS[:1], 3) if quick else (SEEDS, TRIALS)
    return [
        learning_run(root, experiment, seed, trials)
        for experiment in varied_experiments().values()
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success of each run's saved policy from fresh starts, by the true states."""
    starts = 20 if quick else STARTS
    experiments = varied_experiments()
    runs_each = len(folders) // len(experiments)
    learned = [experiment for experiment in experiments.values() for _ in range(runs_each)]
    runs = [
        remeasured(folder, experiment, starts, START_SEED)
        for experiment, folder in zip(learned, folders, strict=True)
    ]
    rates = {
        name: [run["success_rate"] for run in runs if run["experiment"] == name]
        for name in experiments
    }
    by_factor = {
        factor: np.array([rates[experiment.name] for experiment in factor.experiments()]).T
        for factor in FACTORS
    }
    headline = {
        f"success_{name}": rate
        for factor, values in by_factor.items()
        for name, rate in zip(factor.names(), values.mean(0).tolist(), strict=True)
    }
    panels = {factor.label: (factor.levels, values) for factor, values in by_factor.items()}
    figure = plot_success_over_settings(panels, [factor.plain for factor in FACTORS])
    return Results(headline, {"robustness": figure}, {"starts": starts, "measured": runs})


ROBUSTNESS = PaperExperiment(
    "robustness", "ours with other starts, sensors and demonstrations", needed_runs, results
)
