"""Learning within limits of the joints' speeds, and without.

While it learns, the robot must not turn a joint faster than 1.3 times the largest demonstrated
speed. With the limits, a guard stops a rollout that leaves them, and a policy that is likely to
leave them is refused. Without, the study only counts how often and how far the same seeds leave
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from reproduction.learned import remeasured
from reproduction.plots.excursions import plot_excursions
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.control.state_box import StateBox
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.checkpoints import newest_undamaged, rotation_in

SPEED_FACTOR = 1.3  # largest speed of a joint, in largest demonstrated ones
SEEDS = range(10)
TRIALS = {"without": 12, "with": 30}  # the rollouts of refused policies are short, so they are more
STARTS, START_SEED = 100, 5_000_000  # no start that a run has seen


def with_box() -> Task:
    """The double pendulum, with joint speeds limited to little more than was demonstrated.

    Example:
        >>> {name: round(high, 1) for name, (low, high) in with_box().box.items()}
        {'dq1': 5.9, 'dq2': 6.0}
    """
    experiment = load_experiment("double_pendulum")
    largest = (SPEED_FACTOR * experiment.demonstrated_states.abs().amax(0)).tolist()
    names = experiment.space.names
    speeds = {name: (-largest[i], largest[i]) for i, name in enumerate(names) if name[0] == "d"}
    return replace(experiment, name="double_pendulum_box", box=speeds)


def ways() -> dict[str, Task]:
    """The experiments with and without the limits."""
    return {"without": load_experiment("double_pendulum"), "with": with_box()}


@dataclass(frozen=True, eq=False)
class Excursions:
    """How far the rollouts of a run went.

    Args:
        ends_s: seconds of experience at the end of each rollout, (R,).
        furthest: the furthest that each rollout went, in limits: 1 at a limit, (R,).
        transitions: number of transitions that ended outside.
    """

    ends_s: np.ndarray
    furthest: np.ndarray
    transitions: int

    @property
    def rollouts(self) -> int:
        """Number of rollouts that left."""
        return int((self.furthest > 1).sum())


def excursions(folder: Path, box: StateBox, period: float) -> Excursions:
    """Excursions of all rollouts of a run, the exploration included.

    The last checkpoint holds them; the collector still has the last rollout.

    Raises:
        RunError: the run left no checkpoint.
    """
    saved = newest_undamaged(rotation_in(folder / "checkpoints"))
    if saved is None:
        raise RunError(f"{folder} must hold the checkpoints of the run, got none")
    states = saved.states
    parts = (
        states["trainer_module.experience"]["transitions"],
        states["collector"]["latest"]["entries"],
    )
    before = torch.cat([part["observation"] for part in parts])
    after = torch.cat([part["next"]["observation"] for part in parts])
    return _excursions(before, after, box, period)


def _excursions(before: Tensor, after: Tensor, box: StateBox, period: float) -> Excursions:
    """Excursions of transitions from states (N, D) to others, one rollout after the other."""
    widths = box.margins(torch.zeros_like(after[:1]))  # the limits are speeds, alike on both sides
    distances = 1 - (box.margins(after) / widths).amin(-1)
    last = torch.cat([(after[:-1] != before[1:]).any(-1), torch.tensor([True])])
    ends = (last.nonzero()[:, 0] + 1).tolist()
    begins = [0, *ends[:-1]]
    furthest = [distances[begin:end].max().item() for begin, end in zip(begins, ends, strict=True)]
    return Excursions(period * np.array(ends), np.array(furthest), int((distances > 1).sum()))


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Ours with and without the limits; without, it is the plain double pendulum."""
    seeds = SEEDS[:1] if quick else SEEDS
    return [
        learning_run(root, experiment, seed, 3 if quick else TRIALS[way])
        for way, experiment in ways().items()
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Violations over all learning rollouts, experience and success, with and without limits."""
    starts, limited = 20 if quick else STARTS, with_box()
    box = StateBox(limited.space, limited.box or {})
    runs_each = len(folders) // len(TRIALS)
    chunks = dict(zip(TRIALS, (folders[:runs_each], folders[runs_each:]), strict=True))
    headline: dict[str, float] = {}
    measured: list[dict[str, Any]] = []
    drawn = {}
    for way, experiment in ways().items():
        period = experiment.demonstrations.time_step
        found = [excursions(folder, box, period) for folder in chunks[way]]
        runs = [remeasured(folder, experiment, starts, START_SEED) for folder in chunks[way]]
        for excursion, run in zip(found, runs, strict=True):
            outside = {
                "transitions_outside": excursion.transitions,
                "rollouts_outside": excursion.rollouts,
                "rollouts": len(excursion.furthest),
                "furthest_in_limits": excursion.furthest.max().item(),
            }
            measured.append({**run, **outside})
        headline |= _summed(way, measured[-runs_each:])
        drawn[f"{way} limits"] = [(run.ends_s, run.furthest) for run in found]
    headline["experience_ratio"] = headline["experience_s_with"] / headline["experience_s_without"]
    figure = plot_excursions(drawn, "largest speed (in limits)")
    details = {"limits": box.settings, "starts": starts, "measured": measured}
    return Results(headline, {"box": figure}, details)


def _summed(way: str, runs: Sequence[dict]) -> dict[str, float]:
    """Sums of the counts and means of the measurements over runs."""
    counts = ("transitions_outside", "rollouts_outside", "rollouts")
    means = ("experience_s", "success_rate")
    return {
        **{f"{name}_{way}": sum(run[name] for run in runs) for name in counts},
        **{f"{name}_{way}": float(np.mean([run[name] for run in runs])) for name in means},
        f"furthest_in_limits_{way}": max(run["furthest_in_limits"] for run in runs),
    }


BOX = PaperExperiment("box", "learning within limits of the joints' speeds", needed_runs, results)
