"""How one policy of several targets does on a grid of them, beside policies of single targets; and
how that is learned and drawn.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from reproduction.baselines.separate_policies import SeparatePolicies
from reproduction.learned import Learned, load_learned
from reproduction.reproduction import Report, Run, learning_run
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.experiments.runs.run_folder import provenance
from torch_pmil.experiments.runs.summaries import RunError, is_finished
from torch_pmil.experiments.tasks.target_experiment import TargetExperiment
from torch_pmil.files import write_json
from torch_pmil.plotting import Figure, plot_heat_map
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import search_policy

START_SEED = 8_000_000  # no start that a run has seen
METHODS = {
    "joint": "one policy",
    "blended": "one each, blended",
    "nearest": "one each, the nearest",
}
REACHED = 0.5  # of the starts at a grid point: more than this counts as reached
EDGE = 1e-9  # of what a corner counts, beside 1: the triangle's corners may be grid points


@dataclass(frozen=True)
class TargetStudy:
    """Seeds that learn an experiment with three targets in a plane, and a regular grid on which
    they are measured.

    Args:
        name: of the results.
        experiment: makes it.
        columns, rows: coordinates of the grid, increasing.
        trials: largest number of trials.
        value: of rollouts (*batch, T): what is drawn, (*batch).
        labels: of the two axes and of the value, with their units.
        seeds: of the runs.
        starts: at each grid point; at the training targets twice as many.
    """

    name: str
    experiment: Callable[[], TargetExperiment]
    columns: Sequence[float]
    rows: Sequence[float]
    trials: int
    value: Callable[[TensorDictBase], Tensor]
    labels: tuple[str, str, str]
    seeds: Sequence[int]
    starts: int = 10

    @property
    def quick(self) -> TargetStudy:
        """The same in minutes."""
        return replace(self, seeds=self.seeds[:1], trials=2, starts=2)

    @property
    def grid(self) -> Tensor:
        """Its points, (R C, 2), row by row from below."""
        rows, columns = (
            torch.as_tensor(places, dtype=torch.float64) for places in (self.rows, self.columns)
        )
        return torch.cartesian_prod(rows, columns).flip(-1)

    def needed_runs(self, root: Path) -> list[Run]:
        """As ``pmil train`` learns the experiment, and what comes of each at every grid point."""
        return [
            Run(root / self.name / f"seed_{seed}", partial(self._measure, root=root, seed=seed))
            for seed in self.seeds
        ]

    def _measure(self, out: Path, command: str, root: Path, seed: int) -> None:
        source, begun, experiment = provenance(command), time.perf_counter(), self.experiment()
        learning = learning_run(root, experiment, seed, self.trials)
        if not is_finished(learning.out):
            learning.learn(learning.out, command)
        learned = load_learned(learning.out, experiment)
        separate = separate_policies(learned, experiment)
        policies = {
            "joint": learned.policy,
            "blended": SeparatePolicies(separate, experiment.targets),
            "nearest": SeparatePolicies(separate, experiment.targets, nearest=True),
        }
        modules = {
            name: TensorDictModule(policy, in_keys=["observation", "target"], out_keys=["action"])
            for name, policy in policies.items()
        }
        run = {
            "experiment": self.name,
            "seed": seed,
            **source,
            "experience_s": learned.summary["experience_s"],
            "trials": learned.summary["trials"],
            "learning_seconds": learned.summary["wall_seconds"],
            "training": self._outcome(
                modules["joint"], experiment, experiment.targets, 2 * self.starts, seed
            ),
            "grid": {
                name: self._outcome(module, experiment, self.grid, self.starts, seed)
                for name, module in modules.items()
            },
        }
        out.mkdir(parents=True, exist_ok=True)
        write_json(
            out / "summary.json", run | {"wall_seconds": round(time.perf_counter() - begun, 2)}
        )

    @torch.no_grad()
    def _outcome(
        self,
        policy: TensorDictModule,
        experiment: TargetExperiment,
        targets: Tensor,
        starts: int,
        seed: int,
    ) -> dict[str, list[float]]:
        """Success rate and mean value at each target (G, 2), from so many fresh starts."""
        env = experiment.robots_at(targets.repeat_interleave(starts, 0), START_SEED + seed)
        rollouts = env.rollout(experiment.horizon, policy)
        measured = {
            "success": (experiment.error(rollouts) <= experiment.tolerance).double(),
            "value": self.value(rollouts),
        }
        return {
            name: values.unflatten(0, (len(targets), starts)).mean(1).tolist()
            for name, values in measured.items()
        }

    def report(self, folders: Sequence[Path], picture: np.ndarray | None = None) -> Report:
        """Success rates at the training targets, the fraction of the grid that is reached, and the
        heat maps of the first seed.
        """
        runs = [read_measurement(folder) for folder in folders]
        targets = self.experiment().targets
        inside = inside_triangle(self.grid, targets)
        training = np.array([run["training"]["success"] for run in runs])  # (seeds, S)
        headline = {
            "training_success_rate": float(training.mean()),
            "worst_training_success_rate": float(training.min()),
        }
        for name in METHODS:
            rates = np.array([run["grid"][name]["success"] for run in runs])  # (seeds, G)
            prefix = "" if name == "joint" else f"{name}_"
            headline[f"{prefix}grid_fraction"] = float((rates > REACHED).mean())
            headline[f"{prefix}triangle_fraction"] = float((rates[:, inside] > REACHED).mean())
            headline[f"{prefix}grid_success_rate"] = float(rates.mean())
            headline[f"{prefix}mean_distance"] = float(
                np.mean([run["grid"][name]["value"] for run in runs])
            )
        headline["least_grid_fraction"] = min(
            float((np.array(run["grid"]["joint"]["success"]) > REACHED).mean()) for run in runs
        )
        headline["max_trials"] = max(len(run["trials"]) for run in runs)
        headline["max_experience_s"] = max(run["experience_s"] for run in runs)
        headline["median_learning_s"] = float(np.median([run["learning_seconds"] for run in runs]))
        measured = [{key: run[key] for key in ("seed", "training", "grid")} for run in runs]
        losses = [[trial["loss"] for trial in run["trials"]] for run in runs]
        return Report(
            headline,
            {self.name: self._heat_maps(runs[0]["grid"], targets, picture)},
            {"loss": losses, "measured": measured},
        )

    def _heat_maps(
        self, grid: dict[str, dict[str, list[float]]], targets: Tensor, picture: np.ndarray | None
    ) -> Figure:
        shape = len(self.rows), len(self.columns)
        maps = {
            title: (
                np.array(grid[name]["value"]).reshape(shape),
                np.array(grid[name]["success"]).reshape(shape) > REACHED,
            )
            for name, title in METHODS.items()
        }
        across, up, value = self.labels
        return plot_heat_map(
            self.columns,
            self.rows,
            maps,
            targets.numpy(),
            labels=(across, up),
            value=value,
            picture=picture,
        )


def separate_policies(learned: Learned, experiment: TargetExperiment) -> list[StatePolicy]:
    """A policy for each target: what the joint one does there, searched further for this target
    alone, on the same model.
    """
    policies, demonstrated = [], experiment.demonstrated
    for i, target in enumerate(experiment.targets):
        policy = learned.policy.policy.for_target(target)
        loss = TrajectoryKLLoss(
            policy, learned.dynamics, experiment.space, demonstrated[i], experiment.noise_std
        )
        search_policy(loss, experiment.initial, experiment.search)
        policies.append(
            StatePolicy(
                policy.requires_grad_(False), experiment.space, experiment.demonstrations.time_step
            )
        )
    return policies


def inside_triangle(points: Tensor, corners: Tensor) -> np.ndarray:
    """Which points (G, 2) lie in a triangle (3, 2), its edges included, (G,) bool.

    Example:
        >>> corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
        >>> inside_triangle(torch.tensor([[0.5, 0.5], [0.6, 0.6]], dtype=torch.float64), corners).tolist()
        [True, False]
    """
    homogeneous = [
        torch.cat([places, torch.ones_like(places[:, :1])], -1) for places in (points, corners)
    ]
    shares = homogeneous[0] @ homogeneous[1].inverse()  # barycentric coordinates
    return (shares > -EDGE).all(-1).numpy()


def read_measurement(folder: Path) -> dict:
    """What a run of a study wrote.

    Raises:
        RunError: it cannot be read, or is of something else.
    """
    try:
        run = json.loads((folder / "summary.json").read_text())
        run = {
            key: run[key]
            for key in ("seed", "experience_s", "trials", "learning_seconds", "training", "grid")
        }
        return {**run, "grid": {name: run["grid"][name] for name in METHODS}}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: summary.json does not say what was reached: {error}") from error
