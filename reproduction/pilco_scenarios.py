r"""The robots of the PILCO literature, learned from a cost alone; ten seeds.

Pendulum, cart-pole and double pendulum (Deisenroth 2010, Chapter 3;
Deisenroth and Rasmussen 2011) are chains of uniform rods with absolute angles :math:`\theta_j` from
upright. The centre of rod i is at :math:`x + \sum_j c_{ij} \sin\theta_j` and
:math:`\sum_j c_{ij} \cos\theta_j`, with :math:`c_{ij} = l_j` below rod i and half of that of rod i
itself. Lagrange's equations follow from these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box

from reproduction.figure7 import GOAL, finite_median, median_to_goal
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.runge_kutta import runge_kutta
from torch_pmil.control.state_space import MatchSpace
from torch_pmil.plotting import plot_success_over_experience
from torch_pmil.runs.summaries import read_summary, success_over_experience
from torch_pmil.search.target_costs import SaturatingCost
from torch_pmil.tasks.cost_task import CostTask
from torch_pmil.tasks.own_cost import own_cost

SEEDS, QUICK_SEEDS, QUICK_TRIALS = range(10), range(1), 2
GRAVITY, SUBSTEPS, START_STD = 9.82, 5, 0.1

Array = np.ndarray


@dataclass(frozen=True)
class Scenario:
    """A chain of rods, and what it must do: bring its tip upright over 0, and hold it there.

    Args:
        lengths, masses: of the rods, m and kg.
        cart: mass of the cart, kg; None for a chain that hangs on a wall.
        friction: of the cart, N·s/m, or of the joints, N·m·s/rad.
        limits: largest force of the cart, N, or torques of the joints, N·m.
        steps: of a motion.
        period: control period, s.
        width: of the saturating cost, m.
        centres: of the policy.
        trials: largest number of trials.
        published: seconds of experience until the robot has learned, by the authors.
    """

    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    cart: float | None
    friction: float
    limits: tuple[float, ...]
    steps: int
    period: float
    width: float
    centres: int
    trials: int
    published: tuple[float, float] | None

    @property
    def state(self) -> tuple[str, ...]:
        """Names of the entries: each place or angle, then its velocity."""
        joints = [f"q{number + 1}" for number in range(len(self.lengths))]
        places = joints if self.cart is None else ["x", *joints]
        return tuple(name for place in places for name in (place, f"d{place}"))

    def acceleration(self, places: Array, rates: Array, action: Array) -> Array:
        """Accelerations of cart and angles by Lagrange's equations."""
        lengths, masses, n = np.array(self.lengths), np.array(self.masses), len(self.lengths)
        c = np.tril(np.ones((n, n)), -1) * lengths + np.diag(lengths / 2)
        first, both = masses @ c, np.einsum("i,ij,ik->jk", masses, c, c)
        q, dq = places[-n:], rates[-n:]
        apart = q[:, None] - q[None]
        mass = both * np.cos(apart) + np.diag(masses * lengths**2 / 12)
        force = GRAVITY * first * np.sin(q) - (both * np.sin(apart)) @ dq**2
        if self.cart is None:
            torques = action - self.friction * np.diff(dq, prepend=0.0)
            force += torques - np.append(torques[1:], 0.0)
            return np.linalg.solve(mass, force)
        coupling = first * np.cos(q)
        cart = np.array([[self.cart + masses.sum()]])
        whole = np.block([[cart, coupling[None]], [coupling[:, None], mass]])
        pushed = action[0] - self.friction * rates[0] + (first * np.sin(q)) @ dq**2
        return np.linalg.solve(whole, np.append(pushed, force))

    def match(self) -> MatchSpace:
        """Place of the tip, m."""
        D, n = len(self.state), len(self.lengths)
        entries = [self.state.index(f"q{number + 1}") for number in range(n)]
        weights = torch.zeros(2, D + 2 * n, dtype=torch.float64)
        lengths = torch.tensor(self.lengths, dtype=torch.float64)
        weights[0, D : D + n] = weights[1, D + n :] = lengths
        if self.cart is not None:
            weights[0, 0] = 1.0
        return MatchSpace(("tip x", "tip y"), ("m", "m"), torch.eye(D).double()[entries], weights)

    def task(self, name: str) -> CostTask:
        """What is learned."""
        target = {"tip x": 0.0, "tip y": math.fsum(self.lengths)}
        return own_cost(
            ChainEnv(self),
            SaturatingCost(target=target, width=self.width),
            self.steps,
            self.period,
            state=self.state,
            angles=tuple(entry for entry in self.state if entry[0] == "q"),
            match=self.match(),
            name=f"pilco_{name}",
            num_centres=self.centres,
        )


class ChainEnv(gymnasium.Env):
    """A scenario that starts hanging, integrated by Runge-Kutta."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.dt = scenario, scenario.period
        self.observation_space = Box(-np.inf, np.inf, (len(scenario.state),), np.float64)
        high = np.array(scenario.limits, np.float64)
        self.action_space = Box(-high, high, dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Array, dict]:
        """Hang at rest, but for normal deviations of 0.1 of each entry."""
        super().reset(seed=seed)
        hanging = np.array([math.pi * (name[0] == "q") for name in self.scenario.state])
        self.now = hanging + START_STD * self.np_random.standard_normal(len(hanging))
        return self.now.copy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict]:
        """Hold an action for a control period."""
        u, h = np.clip(action, self.action_space.low, self.action_space.high), self.dt / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.now = runge_kutta(lambda state: self._derivative(state, u), self.now, h)
        return self.now.copy(), 0.0, False, False, {}

    def _derivative(self, state: Array, action: Array) -> Array:
        places, rates = state[::2], state[1::2]
        changes = np.empty_like(state)
        changes[::2], changes[1::2] = rates, self.scenario.acceleration(places, rates, action)
        return changes


SCENARIOS = {
    "pendulum": Scenario((1.0,), (1.0,), None, 0.01, (2.5,), 40, 0.1, 0.5, 50, 12, None),
    "cart_pole": Scenario((0.6,), (0.5,), 0.5, 0.1, (10.0,), 40, 0.1, 0.25, 50, 12, (17.5, 17.5)),
    "double_pendulum": Scenario(
        (0.5, 0.5), (0.5, 0.5), None, 0.0, (2.0, 2.0), 25, 0.1, 0.5, 100, 20, (50.0, 75.0)
    ),
}

# 50 centres in place of the published 200, which took four times as long and led no further
CART_DOUBLE = Scenario(
    (0.6, 0.6), (0.5, 0.5), 0.5, 0.1, (20.0,), 40, 0.075, 0.5, 50, 16, (60.0, 90.0)
)


def needed_runs(scenarios: Mapping[str, Scenario], root: Path, quick: bool) -> list[Run]:
    """Each scenario with each seed."""
    seeds = QUICK_SEEDS if quick else SEEDS
    return [
        learning_run(root, each.task(name), seed, QUICK_TRIALS if quick else each.trials)
        for name, each in scenarios.items()
        for seed in seeds
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Seeds that learned, experience and computing until the end, beside what was published."""
    published = {name: each.published for name, each in SCENARIOS.items()}
    found = results_of(list(SCENARIOS), folders)
    return replace(found, details={"published_experience_s": published})


def results_of(names: Sequence[str], folders: Sequence[Path]) -> Results:
    """Seeds that learned, experience and computing until the end, and success over experience.

    A run that did not learn counts as one that takes for ever.
    """
    runs = [read_summary(folder) for folder in folders]
    headline: dict[str, float | None] = {}
    figures = {}
    for name in names:
        own = [run for run in runs if run["experiment"] == f"pilco_{name}"]
        numbers = {
            "runs": len(own),
            "seeds_at_95": sum(map(learned, own)),
            "mean_success": fmean(run["saved_success_rate"] for run in own),
            "least_success": min(run["saved_success_rate"] for run in own),
            "median_experience_s": median_of_learned(own, "experience_s"),
            "median_first_95_s": median_to_goal(own),
            "median_cpu_seconds": median_of_learned(own, "cpu_seconds"),
        }
        headline |= {f"{name}_{key}": number for key, number in numbers.items()}
        curve = success_over_experience(own)
        figures[name] = plot_success_over_experience(
            curve.experience_s, curve.rates, curve.lower, curve.upper
        )
    return Results(headline, figures)


def learned(summary: Mapping[str, Any]) -> bool:
    """Whether the saved policy of a run succeeds from 95 % of its fresh starts."""
    return summary["saved_success_rate"] >= GOAL


def median_of_learned(summaries: Sequence[Mapping[str, Any]], key: str) -> float | None:
    """Median of a number of runs, infinite where a run did not learn; None if that is the median.

    Example:
        >>> runs = [{"saved_success_rate": rate, "s": 2.0} for rate in (1.0, 1.0, 0.5)]
        >>> median_of_learned(runs, "s"), median_of_learned(runs[1:] + runs[2:], "s")
        (2.0, None)
    """
    return finite_median(run[key] if learned(run) else math.inf for run in summaries)


def cart_double_results(folders: Sequence[Path], quick: bool) -> Results:
    """Seeds that learned, and how far the predicted cost, of one for each step, fell."""
    runs = [read_summary(folder) for folder in folders]
    costs = [[trial["loss"] for trial in run["trials"]] for run in runs]
    headline = {
        "seeds": len(runs),
        "seeds_at_95": sum(map(learned, runs)),
        "max_experience_s": max(run["experience_s"] for run in runs),
        "median_cpu_seconds": median(run["cpu_seconds"] for run in runs),
        "steps": CART_DOUBLE.steps,
        "median_least_cost": median(map(min, costs)),
    }
    return Results(headline, {}, {"costs": costs, "published_experience_s": CART_DOUBLE.published})


PILCO_CART_DOUBLE = PaperExperiment(
    "pilco_cart_double",
    "a cart with a double pendulum, from a cost alone",
    partial(needed_runs, {"cart_double": CART_DOUBLE}),
    cart_double_results,
)
PILCO_SCENARIOS = PaperExperiment(
    "pilco_scenarios",
    "robots of the PILCO literature, from a cost alone",
    partial(needed_runs, SCENARIOS),
    results,
)
