"""The cart-pole that imitates its teacher, and then gets up sooner than it, by a cost.

The cost is that of a tip which is not upright in the middle. The imitation counts so little beside
it that the motion of least loss is more than one standard deviation away from the demonstrations.
What is within two of them is a success all the same. Pairs have the same seed, and so the same
imitation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any

import torch
from torch import Tensor

from reproduction.learned import load_learned
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.soak.comparison import paired
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.cart_pole import POLE_LENGTH, CartPoleEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.search.saturating_cost import saturating_cost
from torch_pmil.search.target_costs import SaturatingCost
from torch_pmil.tasks.cart_pole import cart_pole_space
from torch_pmil.tasks.own_robot import own_robot
from torch_pmil.tasks.task import Task

SEEDS, TRIALS = range(10), 16
QUICK_SEEDS, QUICK_TRIALS = range(1), 2
STARTS, START_SEED = 20, 12_000_000  # no start that a run has seen
TARGET = {"x_tip": 0.0, "z_tip": POLE_LENGTH}  # m
WIDTH = 0.3  # m, half the pole
WEIGHT = 0.006  # costs for each nat
UP = 0.5  # m, height of the tip
IMITATION, IMPROVEMENT = "imitation", "improvement"


@cache
def tasks() -> dict[str, Task]:
    """Imitation alone, and imitation that is improved."""
    cost = SaturatingCost(target=TARGET, width=WIDTH)
    return {
        IMITATION: _task(IMITATION),
        IMPROVEMENT: _task(IMPROVEMENT, cost=cost, imitation_weight=WEIGHT),
    }


def _task(way: str, **settings: Any) -> Task:
    """The cart-pole as a robot of one's own, whose rollouts succeed near the demonstrations."""
    space = cart_pole_space()
    return own_robot(
        CartPoleEnv(),
        shipped_demonstrations("cart_pole"),
        control_period=0.1,
        state=space.names,
        units=space.units,
        angles=("q",),
        match=space.match_space,
        name=f"cart_pole_{way}",
        **settings,
    )


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Imitation with each seed, then improvement."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [learning_run(root, task, seed, trials) for task in tasks().values() for seed in seeds]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Cost, time, deviation and success of the teacher and both ways, and what pairs differ by."""
    half = len(folders) // 2
    shown = shipped_demonstrations("cart_pole").positions[:, 1:]
    teacher = {"cost": cost(shown).mean().item(), "up_s": seconds_until_up(shown).mean().item()}
    measured = {
        IMITATION: [_measured(folder, IMITATION) for folder in folders[:half]],
        IMPROVEMENT: [_measured(folder, IMPROVEMENT) for folder in folders[half:]],
    }
    headline: dict[str, float | None] = {f"{key}_teacher": teacher[key] for key in teacher}
    for way, runs in measured.items():
        for key in ("cost", "up_s", "deviation", "success_rate", "experience_s"):
            headline[f"{key}_{way}"] = fmean(run[key] for run in runs)
    for key in ("cost", "up_s"):
        improved = [run[key] for run in measured[IMPROVEMENT]]
        imitated = [run[key] for run in measured[IMITATION]]
        headline |= _less(f"{key}_less_than_teacher", improved, [teacher[key]] * half)
        headline |= _less(f"{key}_less_than_imitation", improved, imitated)
    details = {"teacher": teacher, "measured": measured, "starts": STARTS, "weight": WEIGHT}
    return Results(headline, {}, details)


def cost(observed: Tensor) -> Tensor:
    """Cost (*batch) of motions z_1..z_T in the match space, (*batch, T, 3).

    Example:
        >>> cost(torch.tensor([[0.0, 0.0, 0.6], [0.0, 0.0, -0.6]]))
        tensor(0.9997)
    """
    target = torch.tensor(list(TARGET.values())).to(observed)
    return saturating_cost((observed[..., 1:] - target) / WIDTH).sum(-1)


def seconds_until_up(observed: Tensor) -> Tensor:
    """Time (*batch), s, after which the tip stays up, of motions (*batch, T, 3) at 10 Hz.

    Example:
        >>> seconds_until_up(torch.tensor([[0.0, 0.0, 0.6], [0.0, 0.0, 0.0], [0.0, 0.0, 0.6]]))
        tensor(0.3000)
    """
    below = (observed[..., 2] < UP).to(observed)
    return 0.1 * (1 + below.flip(-1).cummax(-1).values.sum(-1))


def _measured(folder: Path, way: str) -> dict[str, Any]:
    """The main numbers of a run, and means over rollouts of its policy from fresh starts."""
    task = tasks()[way]
    learned = load_learned(folder, task)
    summary, rollouts = learned.summary, learned.rollouts(task, STARTS, START_SEED)
    observed, errors = task.space.observe(states_of(rollouts)[:, 1:]), task.error(rollouts)
    return {
        "experiment": task.name,
        "seed": summary["seed"],
        "cost": cost(observed).mean().item(),
        "up_s": seconds_until_up(observed).mean().item(),
        "deviation": errors.mean().item(),
        "success_rate": (errors <= task.tolerance).double().mean().item(),
        "experience_s": summary["experience_s"],
        "trials": len(summary["trials"]),
        "saved_trial": summary["saved_trial"],
        "stop_reason": summary["stop_reason"],
    }


def _less(
    name: str, improved: Sequence[float], other: Sequence[float]
) -> Mapping[str, float | None]:
    """Mean by which the improved runs have less than the others, and its interval."""
    found = paired(list(zip(other, improved, strict=True)))
    return {
        name: found["difference"],
        f"{name}_lower": found["lower"],
        f"{name}_upper": found["upper"],
    }


IMPROVEMENT_STUDY = PaperExperiment(
    "improvement", "the cart-pole that imitates, and then gets up sooner", needed_runs, results
)
