"""Samples of functions beside moments and draws at each step: their price, and whom to believe.

Price: CPU time of value and gradient on the problem of ``benchmarks.breakdown``, by moments and by
100 functions. The fastest of several evaluations counts.

Belief: after the search of each trial of some runs, its policy starts 100 times anew. Coverage is
the share of the states within two predicted standard deviations, by moments and by 500 functions.
The Brier score is the mean square of predicted success less success, by functions and by particles
that are drawn anew at each step. A figure has the rates that each predicted beside those measured.

Example:
    python -m benchmarks.samples
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from benchmarks.breakdown import HORIZON, evaluation
from benchmarks.command_line import add_json, cpu_seconds, source_of, write_summary
from benchmarks.workloads import make_problem
from reproduction.plots.calibration import plot_success_calibration
from reproduction.replayed_runs import Forecast, drawn
from torch_pmil.envs.rollouts import states_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.calibration import two_sigma_coverage
from torch_pmil.model.particles import sample_rollouts
from torch_pmil.model.rollout import PredictionError
from torch_pmil.model.sampled_rollouts import (
    follow_functions,
    noise_of_steps,
    sample_consistent_rollouts,
)
from torch_pmil.plotting import Figure, save_figure
from torch_pmil.runs.training import make_trainer
from torch_pmil.search.promise import SAMPLES
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.trainer.trainer import PMILTrainer

SIZES = (100, 200, 400, 1000, 5000)
LARGEST_OF_MOMENTS = 1000  # beyond, a model's posterior is sparse
FUNCTIONS, REPEATED, STARTS, TRIALS = 100, 20, 100, 8
TASKS, SEEDS = ("double_pendulum", "cart_pole"), range(5)
PREDICTORS = {"samples": "functions of the posterior", "steps": "drawn anew at each step"}


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add_json(parser, "samples")
    arguments = parser.parse_args()
    source = source_of("samples")
    torch.set_num_threads(1)
    speeds = [speed(n) for n in SIZES]
    for row in speeds:
        print(", ".join(f"{name} {value:g}" for name, value in row.items()), flush=True)
    policies = [row for name in TASKS for seed in SEEDS for row in run(name, seed)]
    headline = {f"cpu_ms_n{row['n']}": row["functions_ms"] for row in speeds}
    for name in ("coverage_samples", "coverage_moments", "brier_samples", "brier_steps"):
        known = [row[name] for row in policies if row[name] is not None]
        headline[name] = sum(known) / len(known)
    print(headline)
    save_figure(calibration(policies), arguments.json.with_name("calibration.png"))
    write_summary(
        arguments.json,
        {
            "experiment": "samples",
            **source,
            "headline": headline,
            "speeds": speeds,
            "policies": policies,
        },
    )


def speed(n: int) -> dict[str, float]:
    """Milliseconds of value and gradient by moments and by functions, and of drawing these."""
    problem = make_problem(n, HORIZON, most_exact=max(SIZES))
    dynamics, policy, space = problem.dynamics, problem.policy, problem.experiment.space
    generator = torch.Generator().manual_seed(0)
    functions = dynamics.functions(FUNCTIONS, generator)
    start = problem.experiment.initial.sample(FUNCTIONS, generator)
    noise = noise_of_steps(dynamics, (FUNCTIONS, HORIZON), generator)

    def follow() -> object:
        states = follow_functions(start, policy, functions, dynamics, space, noise)
        return torch.autograd.grad(states.square().sum(), list(policy.parameters()))

    row = {
        "n": n,
        "functions_ms": fastest(follow),
        "drawing_ms": fastest(partial(dynamics.functions, FUNCTIONS, generator)),
    }
    return row | ({"moments_ms": fastest(evaluation(n))} if n <= LARGEST_OF_MOMENTS else {})


def fastest(function: Callable[[], object]) -> float:
    """CPU milliseconds of the fastest call of several."""
    return round(1e3 * min(cpu_seconds(function) for _ in range(REPEATED)), 2)


def run(name: str, seed: int) -> list[dict[str, Any]]:
    """Coverage and Brier scores of the policies of a run, one in each trial."""
    task, rows = load_experiment(name), list[dict[str, float | None]]()
    trainer = make_trainer(task, seed, TRIALS, False, lambda trial: None)
    env = task.make_env(num_envs=STARTS, seed=10_000 + seed)

    def judge() -> None:
        if trainer.actor.exploring:
            return
        rollouts = env.rollout(task.horizon, trainer.robot_policy)
        success = float((task.error(rollouts) <= task.tolerance).float().mean())
        rows.append({"seed": seed, "success": success, **scores(trainer, rollouts, success)})
        print(name, rows[-1], flush=True)

    trainer.register_op("post_steps", judge)
    trainer.train()
    return [{"task": name, **row} for row in rows]


@torch.no_grad()
def scores(trainer: PMILTrainer, rollouts: Tensor, success: float) -> dict[str, float | None]:
    """What the trial's model predicted of these rollouts, and how far that was from them."""
    loss, promise = trainer.loss_module, trainer.promise
    given = loss.actor_network, loss.dynamics, loss.space, loss.horizon
    functions = loss.dynamics.functions(SAMPLES, torch.Generator().manual_seed(1))
    policy, *others = given
    consistent = sample_consistent_rollouts(
        trainer.initial, policy, functions, SAMPLES, *others, torch.Generator().manual_seed(2)
    )
    steps = sample_rollouts(trainer.initial, *given, SAMPLES, torch.Generator().manual_seed(1))
    seen = states_of(rollouts)
    sampled = consistent[:, 1:]
    try:
        moments = two_sigma_coverage(loss.predict_states(trainer.initial), seen)
    except PredictionError:
        moments = None
    spread = Gaussian(sampled.mean(0), torch.diag_embed(sampled.var(0)))
    result: dict[str, float | None] = {
        "coverage_samples": two_sigma_coverage(spread, seen),
        "coverage_moments": moments,
    }
    for name, states in zip(PREDICTORS, (consistent, steps), strict=True):
        rate = float((promise.error(states) <= promise.tolerance).double().mean())
        result[f"predicted_{name}"] = rate
        result[f"brier_{name}"] = (rate - success) ** 2 + success * (1 - success)
    return result


def calibration(policies: Sequence[Mapping[str, Any]]) -> Figure:
    """Measured over predicted success of the policies, a panel for each way of predicting."""
    return plot_success_calibration(
        {
            title: drawn([Forecast(row[f"predicted_{name}"], row["success"]) for row in policies])
            for name, title in PREDICTORS.items()
        }
    )


if __name__ == "__main__":
    main()
