"""A policy and models of a user's own, each beside the default on the same seeds.

A network of two layers swings up the double pendulum. On the cart-pole the model knows physics
whose masses and length are wrong by a third, and GPs learn what that leaves. There too, the
GPs of another model have a Matern kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import torch
from torch import Tensor, nn

from examples.own_models import Matern, WithPhysics
from reproduction.figure7 import GOAL, experience_to_goal, median_to_goal
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from reproduction.sampling_frequency import Interval
from torch_pmil.plotting import plot_success_over_experience
from torch_pmil.runs.summaries import read_summary, success_over_experience
from torch_pmil.tasks.own_parts import with_own
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

SEEDS, QUICK_SEEDS, QUICK_TRIALS, TRIALS = range(10), range(1), 2, 12
FEWER = 2  # seeds of the Matern kernel, whose formulas in PyTorch take minutes a trial
GRAVITY, FRICTION, PERIOD, SUBSTEPS = 9.82, 0.1, 0.1, 2
OFF = 4 / 3  # by which masses and length of the physics are wrong
CART, POLE, LENGTH = OFF * 0.5, OFF * 0.5, OFF * 0.6  # kg, kg, m


def two_layers(inputs: int, outputs: int) -> nn.Module:
    """A network of two hidden layers of 32."""
    return nn.Sequential(
        nn.Linear(inputs, 32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, outputs)
    )


def cart_pole_changes(inputs: Tensor) -> Tensor:
    """Changes of [dx, dq] in a step, (*batch, 2), by the equations of a pole on a cart.

    Those are what the task learns, since positions follow from velocities. Inputs are
    [x, dx, dq, sin q, cos q] and the force, (*batch, 6).

    Example:
        >>> upright = torch.tensor([0.0, 0.0, 0.0, 0.0, 1.0, 0.0], dtype=torch.float64)
        >>> cart_pole_changes(upright).abs().max().item()
        0.0
    """
    _, first_dx, first_dq, sine, cosine, force = inputs.unbind(-1)
    q, dx, dq = torch.atan2(sine, cosine), first_dx, first_dq
    half, inertia = POLE * LENGTH / 2, POLE * LENGTH**2 / 3
    for _ in range(SUBSTEPS):
        s, c = q.sin(), q.cos()
        on_cart = force - FRICTION * dx + half * s * dq.square()
        on_pole = half * GRAVITY * s
        det = (CART + POLE) * inertia - (half * c).square()
        dx = dx + PERIOD / SUBSTEPS * (inertia * on_cart - half * c * on_pole) / det
        dq = dq + PERIOD / SUBSTEPS * ((CART + POLE) * on_pole - half * c * on_cart) / det
        q = q + PERIOD / SUBSTEPS * dq
    return torch.stack([dx - first_dx, dq - first_dq], -1)


def pairs() -> dict[str, tuple[Task, Task]]:
    """The default and what is a user's own, by what that is."""
    swing_up, cart = load_experiment("double_pendulum"), load_experiment("cart_pole")
    own = {
        "network": (swing_up, with_own(swing_up, None, two_layers, None)),
        "physics": (cart, with_own(cart, None, None, WithPhysics(cart_pole_changes))),
        "matern": (cart, with_own(cart, None, None, Matern())),
    }
    return {
        what: (default, replace(task, name=f"{default.name}_{what}"))
        for what, (default, task) in own.items()
    }


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """Each task with its seeds, the defaults once."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if quick else (SEEDS, TRIALS)
    tasks = {task.name: task for both in pairs().values() for task in both}
    return [
        learning_run(root, task, seed, trials)
        for task in tasks.values()
        for seed in (seeds if "matern" not in task.name else seeds[:FEWER])
    ]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success and experience of each, and what each seed differs by."""
    runs = [read_summary(folder) for folder in folders]
    headline: dict[str, float | None] = {}
    figures = {}
    for what, both in pairs().items():
        own = [[run for run in runs if run["experiment"] == task.name] for task in both]
        for label, found in zip(("default", what), own, strict=True):
            numbers = {
                "runs": len(found),
                "seeds_at_95": sum(run["saved_success_rate"] >= GOAL for run in found),
                "median_first_95_s": median_to_goal(found),
            }
            name = what if label == what else f"{what}_default"
            headline |= {f"{name}_{key}": number for key, number in numbers.items()}
        count = min(map(len, own))  # in the order of the seeds
        firsts = [[experience_to_goal(run) for run in found[:count]] for found in own]
        apart = torch.tensor(firsts[1]).double() - torch.tensor(firsts[0]).double()
        known = apart[apart.isfinite()]
        headline[f"{what}_pairs"] = len(known)  # of which both sides reached 95 %
        headline[f"{what}_later_s"] = fmean(known.tolist()) if len(known) else None
        if len(known) > 1:
            headline[f"{what}_later_s_half_interval"] = Interval.of(known).half_width
        curve = success_over_experience(own[1])
        figures[what] = plot_success_over_experience(
            curve.experience_s, curve.rates, curve.lower, curve.upper
        )
    return Results(headline, figures)


OWN_PARTS = PaperExperiment(
    "own_parts",
    "a network, known physics and a Matern kernel, beside the default",
    needed_runs,
    results,
)
