"""Section 5.2.5, Figure 11: one policy of the BioRob hits balls in a plane; five seeds of at most fifteen trials."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from torch_pmil.baselines.separate_policies import SeparatePolicies
from torch_pmil.envs.hitting_plane import COLUMNS, GRID, ROWS, TRAINING_TARGETS
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.paper.learned import Learned, load_learned
from torch_pmil.experiments.paper.reproduction import PaperExperiment, Report, Run, learning_run
from torch_pmil.experiments.run_folder import provenance
from torch_pmil.experiments.runs import RunError, is_finished
from torch_pmil.experiments.target_experiment import TargetExperiment
from torch_pmil.files import write_json
from torch_pmil.objective import TrajectoryKLLoss
from torch_pmil.plotting import Figure, plot_heat_map
from torch_pmil.policy_search import search_policy
from torch_pmil.state_policy import StatePolicy

SEEDS, TRIALS, STARTS = range(5), 15, 10
QUICK_SEEDS, QUICK_TRIALS, QUICK_STARTS = range(1), 2, 2
START_SEED = 8_000_000  # no start that a run has seen
METHODS = {"joint": "one policy", "blended": "three policies, blended", "nearest": "policy of the nearest target"}
EDGE = 1e-9  # of what a corner counts, beside 1: the triangle's corners are grid points


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """As ``scripts/train.py experiment=biorob_targets`` learns, and what comes of each at every ball."""
    seeds = QUICK_SEEDS if quick else SEEDS
    return [Run(root / "figure11" / f"seed_{seed}", partial(measure, root=root, seed=seed, quick=quick)) for seed in seeds]


def measure(out: Path, command: str, root: Path, seed: int, quick: bool) -> None:
    """Learn, then let the policy and those that it is compared with strike at every ball from fresh starts; ``summary.json`` says how."""
    source, begun = provenance(command), time.perf_counter()
    experiment, starts = load_experiment("biorob_targets"), QUICK_STARTS if quick else STARTS
    learning = learning_run(root, experiment, seed, QUICK_TRIALS if quick else TRIALS)
    if not is_finished(learning.out):
        learning.learn(learning.out, command)
    learned = load_learned(learning.out, experiment)
    separate = separate_policies(learned, experiment, iterations=2 if quick else experiment.search.final_iterations)
    policies = {
        "joint": learned.policy,
        "blended": SeparatePolicies(separate, experiment.targets),
        "nearest": SeparatePolicies(separate, experiment.targets, nearest=True),
    }
    measured = {name: strikes(policy.as_tensordict_module(), experiment, GRID, starts, seed) for name, policy in policies.items()}
    training = strikes(learned.policy.as_tensordict_module(), experiment, experiment.targets, 2 * starts, seed)
    out.mkdir(parents=True, exist_ok=True)
    run = {"experiment": "figure11", "seed": seed, **source, "experience_s": learned.summary["experience_s"]}
    run |= {"trials": len(learned.summary["trials"]), "kl": [trial["kl"] for trial in learned.summary["trials"]]}
    run |= {"learning_seconds": learned.summary["wall_seconds"], "training": training, "grid": measured}
    write_json(out / "summary.json", run | {"wall_seconds": round(time.perf_counter() - begun, 2)})


def separate_policies(learned: Learned, experiment: TargetExperiment, iterations: int) -> list[StatePolicy]:
    """A policy for each target: what the joint one does there, searched further for this target alone, on the same model."""
    policies = []
    for target, expert in zip(experiment.targets, experiment.expert, strict=True):
        policy = learned.policy.policy.for_target(target)
        loss = TrajectoryKLLoss(policy, learned.dynamics, experiment.space, expert, experiment.noise_std)
        search_policy(loss, experiment.initial, replace(experiment.search, final_iterations=iterations))
        policies.append(StatePolicy(policy.requires_grad_(False), experiment.space, experiment.demonstrations.time_step))
    return policies


@torch.no_grad()
def strikes(policy: TensorDictModule, experiment: TargetExperiment, targets: Tensor, starts: int, seed: int) -> dict[str, list[float]]:
    """At each target (G, 2), from so many fresh starts: hit rate, and mean least distance (m) of the racket's centre from the ball's."""
    env = experiment.robots_at(targets.repeat_interleave(starts, 0), START_SEED + seed)
    info = env.rollout(experiment.horizon, policy)["next", "info"]
    hit, distance = info["hit"][:, -1, 0].double(), info["centre_distance"][..., 0].amin(-1)
    return {name: value.unflatten(0, (len(targets), starts)).mean(1).tolist() for name, value in (("hit", hit), ("distance", distance))}


def report(folders: Sequence[Path], quick: bool) -> Report:
    """Hit rates of the training targets, the fraction of the grid that is hit, and the heat maps of the first seed."""
    runs = [read_measurement(folder) for folder in folders]
    training = np.array([run["training"]["hit"] for run in runs])  # (seeds, S)
    headline = {"training_hit_rate": float(training.mean()), "worst_training_target_hit_rate": float(training.min())}
    for name in METHODS:
        hit = np.array([run["grid"][name]["hit"] for run in runs])  # (seeds, G)
        prefix = "" if name == "joint" else f"{name}_"
        headline[f"{prefix}grid_hit_fraction"] = float((hit > 0.5).mean())
        headline[f"{prefix}triangle_hit_fraction"] = float((hit[:, inside_triangle()] > 0.5).mean())
        headline[f"{prefix}grid_hit_rate"] = float(hit.mean())
    headline["least_grid_hit_fraction"] = min(float((np.array(run["grid"]["joint"]["hit"]) > 0.5).mean()) for run in runs)
    headline["max_experience_s"] = max(run["experience_s"] for run in runs)
    headline["median_learning_s"] = float(np.median([run["learning_seconds"] for run in runs]))
    details = {"measured": [{key: run[key] for key in ("seed", "trials", "kl", "training", "grid")} for run in runs]}
    return Report(headline, {"figure11": heat_maps(runs[0]["grid"])}, details)


def inside_triangle() -> np.ndarray:
    """Which grid points lie in the triangle of the training targets, its edges included, (G,) bool.

    Example:
        >>> inside_triangle().sum()
        np.int64(9)
    """
    corners = torch.cat([TRAINING_TARGETS, torch.ones(len(TRAINING_TARGETS), 1, dtype=torch.float64)], -1)
    shares = torch.cat([GRID, torch.ones(len(GRID), 1, dtype=torch.float64)], -1) @ corners.inverse()  # barycentric coordinates
    return (shares > -EDGE).all(-1).numpy()


def heat_maps(grid: dict[str, dict[str, list[float]]]) -> Figure:
    """Least distance of the racket's centre from the ball's over the grid, for each method (Figure 11 (b))."""
    shape = len(ROWS), len(COLUMNS)
    maps = {
        title: (np.array(grid[name]["distance"]).reshape(shape), np.array(grid[name]["hit"]).reshape(shape) > 0.5)
        for name, title in METHODS.items()
    }
    return plot_heat_map(
        COLUMNS, ROWS, maps, TRAINING_TARGETS.numpy(), labels=("y (m)", "z (m)"), value="least distance of racket and ball (m)"
    )


def read_measurement(folder: Path) -> dict:
    """What :func:`measure` wrote.

    Raises:
        RunError: it cannot be read, or is of something else.
    """
    try:
        run = json.loads((folder / "summary.json").read_text())
        if run["grid"].keys() >= METHODS.keys() and math.isfinite(run["learning_seconds"]) and len(run["training"]["hit"]):
            return run
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: summary.json does not say what was hit: {error}") from error
    raise RunError(f"{folder}: summary.json does not say what was hit by {', '.join(METHODS)}")


FIGURE11 = PaperExperiment("figure11", "one policy hits balls in a plane (Section 5.2.5, Figure 11)", needed_runs, report)
