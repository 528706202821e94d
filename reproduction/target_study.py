"""Studies of one policy of several targets on a grid, beside policies of single targets."""

from __future__ import annotations

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
from reproduction.reproduction import Results, Run, learning_run
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.files import read_json, write_json
from torch_pmil.plotting import Figure, plot_heat_map
from torch_pmil.runs.run_folder import provenance
from torch_pmil.runs.summaries import RunError
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import search_policy
from torch_pmil.tasks.targets import TargetTask

START_SEED = 8_000_000  # no start that a run has seen
METHODS = {
    "joint": "one policy",
    "blended": "one each, blended",
    "nearest": "one each, the nearest",
}
MEASURED = ("seed", "experience_s", "trials", "learning_seconds", "training", "grid")
REACHED = 0.5  # of the starts at a grid point: more than this counts as reached
EDGE = 1e-9  # of a barycentric coordinate: the triangle's corners may be grid points


@dataclass(frozen=True)
class TargetStudy:
    """Seeds that learn an experiment with three targets in a plane, measured on a regular grid.

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
    experiment: Callable[[], TargetTask]
    columns: Sequence[float]
    rows: Sequence[float]
    trials: int
    value: Callable[[TensorDictBase], Tensor]
    labels: tuple[str, str, str]
    seeds: Sequence[int]
    starts: int = 10

    @property
    def quick(self) -> TargetStudy:
        """This study, reduced to a few minutes."""
        return replace(self, seeds=self.seeds[:1], trials=2, starts=2)

    @property
    def grid(self) -> Tensor:
        """Points of the grid, (R C, 2), row by row from below."""
        rows = torch.as_tensor(self.rows, dtype=torch.float64)
        columns = torch.as_tensor(self.columns, dtype=torch.float64)
        return torch.cartesian_prod(rows, columns).flip(-1)

    def needed_runs(self, root: Path) -> list[Run]:
        """Runs of the experiment as ``pmil train`` learns it, measured at every grid point."""
        return [
            Run(root / self.name / f"seed_{seed}", partial(self._measure, root=root, seed=seed))
            for seed in self.seeds
        ]

    def _measure(self, out: Path, command: str, root: Path, seed: int) -> None:
        source, begun, experiment = provenance(command), time.perf_counter(), self.experiment()
        learning = learning_run(root, experiment, seed, self.trials)
        if not learning.finished:
            learning.learn(learning.out, command)
        learned = load_learned(learning.out, experiment)
        modules = policies_of_methods(learned, experiment)
        training = self._measured_at(
            modules["joint"], experiment, experiment.targets, 2 * self.starts, seed
        )
        grid = {
            name: self._measured_at(module, experiment, self.grid, self.starts, seed)
            for name, module in modules.items()
        }
        run = {
            "experiment": self.name,
            "seed": seed,
            **source,
            "experience_s": learned.summary["experience_s"],
            "trials": learned.summary["trials"],
            "learning_seconds": learned.summary["wall_seconds"],
            "training": training,
            "grid": grid,
            "wall_seconds": round(time.perf_counter() - begun, 2),
        }
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "summary.json", run)

    @torch.no_grad()
    def _measured_at(
        self,
        policy: TensorDictModule,
        experiment: TargetTask,
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

    def results(self, folders: Sequence[Path], picture: np.ndarray | None = None) -> Results:
        """Success at the training targets, the fraction of the grid that is reached, and heat maps.

        The heat maps are those of the first seed.
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
            values = np.array([run["grid"][name]["value"] for run in runs])
            prefix = "" if name == "joint" else f"{name}_"
            headline[f"{prefix}grid_fraction"] = float((rates > REACHED).mean())
            headline[f"{prefix}triangle_fraction"] = float((rates[:, inside] > REACHED).mean())
            headline[f"{prefix}grid_success_rate"] = float(rates.mean())
            headline[f"{prefix}mean_distance"] = float(values.mean())
        joint = np.array([run["grid"]["joint"]["success"] for run in runs])
        headline["least_grid_fraction"] = float((joint > REACHED).mean(1).min())
        headline["max_trials"] = max(len(run["trials"]) for run in runs)
        headline["max_experience_s"] = max(run["experience_s"] for run in runs)
        headline["median_learning_s"] = float(np.median([run["learning_seconds"] for run in runs]))
        measured = [{key: run[key] for key in ("seed", "training", "grid")} for run in runs]
        losses = [[trial["loss"] for trial in run["trials"]] for run in runs]
        return Results(
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


def policies_of_methods(learned: Learned, experiment: TargetTask) -> dict[str, TensorDictModule]:
    """The policy of each of the ``METHODS``, for rollouts."""
    separate, targets = separate_policies(learned, experiment), experiment.targets
    policies = {
        "joint": learned.policy,
        "blended": SeparatePolicies(separate, targets),
        "nearest": SeparatePolicies(separate, targets, nearest=True),
    }
    return {
        name: TensorDictModule(policy, in_keys=["observation", "target"], out_keys=["action"])
        for name, policy in policies.items()
    }


def separate_policies(learned: Learned, experiment: TargetTask) -> list[StatePolicy]:
    """A policy for each target, from the joint policy there by further search for it alone.

    The model is the same for all.
    """
    policies, demonstrated = [], experiment.demonstrated
    for i, target in enumerate(experiment.targets):
        joint = learned.policy.policy
        assert isinstance(joint, RBFPolicy)  # as every policy for several targets is
        policy = joint.for_target(target)
        loss = TrajectoryKLLoss(
            policy, learned.dynamics, experiment.space, demonstrated[i], experiment.noise_std
        )
        search_policy(loss, experiment.initial, experiment.method.search)
        policy.requires_grad_(False)
        time_step = experiment.demonstrations.time_step
        policies.append(StatePolicy(policy, experiment.space, time_step))
    return policies


def inside_triangle(points: Tensor, corners: Tensor) -> np.ndarray:
    """Whether points (G, 2) lie in a triangle (3, 2), its edges included, (G,) bool.

    Example:
        >>> corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
        >>> points = torch.tensor([[0.5, 0.5], [0.6, 0.6]], dtype=torch.float64)
        >>> inside_triangle(points, corners).tolist()
        [True, False]
    """
    points = torch.cat([points, torch.ones_like(points[:, :1])], -1)  # homogeneous
    corners = torch.cat([corners, torch.ones_like(corners[:, :1])], -1)
    shares = points @ corners.inverse()  # barycentric coordinates
    return (shares > -EDGE).all(-1).numpy()


def read_measurement(folder: Path) -> dict:
    """The measurement that a run of a study wrote.

    Raises:
        RunError: it cannot be read, or is of something else.
    """
    try:
        summary = read_json(folder / "summary.json")
        run = {key: summary[key] for key in MEASURED}
        return {**run, "grid": {name: run["grid"][name] for name in METHODS}}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: summary.json does not say what was reached: {error}") from error
