"""Robots of gymnasium, learned from a cost alone with the programs of the page on PILCO; ten seeds.

InvertedPendulum-v5 is brought to rest in the middle. Pendulum-v1 begins at any angle, and is swung
up within 8 s and held to the end of 10 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from reproduction.pilco_scenarios import QUICK_SEEDS, QUICK_TRIALS, SEEDS, results_of
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.search.target_costs import SaturatingCost
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.own_cost import own_cost

NAMES, TRIALS = ("inverted_pendulum", "any_angle"), 12


def tasks() -> list[CostTask]:
    """The two, with default settings.

    Example:
        >>> [task.name for task in tasks()]
        ['pilco_inverted_pendulum', 'pilco_any_angle']
    """
    balanced = own_cost(
        "InvertedPendulum-v5",
        SaturatingCost(target={"x": 0.0, "q": 0.0}, width=0.1),
        horizon=50,
        control_period=0.04,
        state=("x", "q", "dx", "dq"),
        name="pilco_inverted_pendulum",
    )
    any_angle = own_cost(
        "Pendulum-v1",
        SaturatingCost(target={"cos q": 1.0, "sin q": 0.0}, width=0.5),
        horizon=100,
        control_period=0.1,
        state=("cos q", "sin q", "dq"),
        name="pilco_any_angle",
    )
    return [balanced, any_angle]


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Each robot with each seed."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    return [learning_run(root, task, seed, trials) for task in tasks() for seed in seeds]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Seeds that learned, experience and computing until the end."""
    return results_of(NAMES, folders)


PILCO_GYMNASIUM = PaperExperiment(
    "pilco_gymnasium", "robots of gymnasium, from a cost alone", needed_runs, results
)
