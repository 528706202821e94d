"""Ablation: the double pendulum with one choice of the method at a time made otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from reproduction.plots.variants import plot_variants
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import ForwardModel, Targets
from torch_pmil.model.particles import ParticlePrediction
from torch_pmil.model.rollout import predict_trajectory
from torch_pmil.runs.summaries import read_summary
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.trajectory_loss import Prediction
from torch_pmil.tasks.cost_task import random_states
from torch_pmil.tasks.pilco import VELOCITY_STD
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEEDS, TRIALS = range(3), 10
QUICK_SEEDS, QUICK_TRIALS = range(1), 2
PARTICLES = 100
AT_ONCE = 2  # times the iterations that each horizon has, where there is only one
MEAN_COST = 12  # an evaluation of the mean alone costs a twelfth of one of the loss, or less
LABELS = {
    "ours": "ours",
    "no_growing_horizon": "whole horizon at once",
    "no_mean_start": "no runs on the mean",
    "random_centres": "random centres",
    "noise_0.02m": "noise floor 0.02 m",
    "noise_0.1m": "noise floor 0.1 m",
    "plain_angles": "plain angles",
    "successors": "successors as targets",
    "particles": f"{PARTICLES} particles",
}


@dataclass(frozen=True, eq=False)
class Variation(Task):
    """A task with choices made otherwise that are no settings of an experiment.

    Args:
        targets: what the model learns.
        prediction: how the loss predicts.
        random_centres: whether the policy's centres are all over the state space, and not near
            demonstrated states.
    """

    targets: Targets = "difference"
    prediction: Prediction = predict_trajectory
    random_centres: bool = False

    @property
    def settings(self) -> dict[str, object]:
        """Numbers that a run depends on."""
        own: dict[str, object] = {
            "targets": self.targets,
            "prediction": "moment matching",
            "random_centres": self.random_centres,
            "angles": list(self.space.angles),
        }
        if isinstance(self.prediction, ParticlePrediction):
            own["prediction"] = vars(self.prediction)
        return super().settings | own

    def make_dynamics(self) -> GPDynamics:
        """A forward model of the robot, without data."""
        inputs = len(self.space.feature_names) + len(self.actions.names)
        return GPDynamics(inputs, self.space.dim, self.targets)

    def make_loss(self, policy: AnyPolicy, dynamics: ForwardModel) -> TrajectoryKLLoss:
        """The loss of the policy search: the KL of demonstrated and predicted trajectories."""
        return TrajectoryKLLoss(
            policy,
            dynamics,
            self.space,
            self.demonstrated,
            self.noise_std,
            prediction=self.prediction,
        )

    def make_policy(self, generator: torch.Generator) -> AnyPolicy:
        """A new policy with centres near demonstrated states, or near random ones."""
        if self.random_centres:
            std = torch.full((self.space.dim,), VELOCITY_STD, dtype=torch.float64)
            states = random_states(self.space, self.initial.mean, std, generator)
            return self.policy_near(self.space.features(states), generator)
        return super().make_policy(generator)


def variations() -> dict[str, Variation]:
    """The double pendulum as it is, and with each choice made otherwise.

    Iterations that a choice would save go elsewhere.

    Example:
        >>> variations()["noise_0.1m"].noise_std
        0.1
    """
    task = load_experiment("double_pendulum")
    ours = Variation(**{entry.name: getattr(task, entry.name) for entry in fields(task)})
    policy, search = task.method.policy, task.method.search
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
    changes: dict[str, dict[str, Any]] = {
        "ours": {},
        "no_growing_horizon": {"method": replace(task.method, search=at_once)},
        "no_mean_start": {"method": replace(task.method, search=no_mean_start)},
        "random_centres": {"random_centres": True},
        "noise_0.02m": {"noise_std": 0.02},
        "noise_0.1m": {"noise_std": 0.1},
        "plain_angles": {
            "space": replace(task.space, angles=()),
            "method": replace(task.method, policy=replace(policy, least_widths=None)),
        },
        "successors": {"targets": "successor"},
        "particles": {"prediction": ParticlePrediction(PARTICLES)},
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
    """Success of the saved policies, and experience up to the first own rollout that succeeded."""
    found = results_of_variants(LABELS, "ablation", folders)
    return replace(found, details={"particles": PARTICLES, **found.details})


def results_of_variants(labels: Mapping[str, str], name: str, folders: Sequence[Path]) -> Results:
    """The same of any variants with equally many runs.

    Args:
        labels: of the variants in the figure, by their names.
        name: of the figure.
        folders: of the runs, variant by variant.
    """
    outcomes = [success_and_experience(read_summary(folder)) for folder in folders]
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
    }
    return Results(headline, {name: figure}, details)


def success_and_experience(summary: dict) -> tuple[float, float, bool]:
    """Success rate, seconds of experience up to the first success, and whether there was one.

    The rate is that of the run's saved policy; a success is an own rollout that succeeded.

    Without success they are all its seconds: no fewer would have done.
    """
    successes = [trial["experience_s"] for trial in summary["trials"] if trial["own_success"]]
    seconds = successes[0] if successes else summary["experience_s"]
    return summary["saved_success_rate"], seconds, bool(successes)


ABLATION = PaperExperiment("ablation", "what each choice of the method earns", needed_runs, results)
