"""Sparse posteriors beside exact ones: cost, KL, coverage, time of a fit and memory.

Two robots: the UR5e of ``reproduction/arms.py`` (18 inputs of the model, 6 outputs), whose
transitions come from random targets along the demonstrations, and the double pendulum (8 inputs, 4
outputs), from random torques around those of a learned policy. The targets have noise of 3 % of
their standard deviation, as from sensors, or none for comparison.

The KL is that of one policy under the exact and the sparse posterior of the same hyper-parameters.
The policy was found with the sparse model of 1000 transitions (UR5e), or comes with the package
(double pendulum). Coverage is that of 3000 other transitions, noise included. One thread.

Example:
    make arms
    python -m benchmarks.sparse
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

import torch
from torch import Tensor

from benchmarks.command_line import add_json, cpu_seconds, source_of, write_summary
from benchmarks.measure import forget_peak, memory_mb
from reproduction.arms import UR5E, arm_experiment
from torch_pmil import GPDynamics, RBFPolicy
from torch_pmil.control.exploration import RandomActions
from torch_pmil.control.policy_file import load_policy
from torch_pmil.model.experience import gp_data
from torch_pmil.search.policy_search import search_policy
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

FEW, SOME, MANY, TESTED = 200, 1000, 5000, 3000  # transitions
NOISES = (0.03, 0.0)  # of what the model is to say, in its standard deviations
RANDOM_TORQUE = 0.3  # of half the range
REPEATS = 7  # evaluations of each model
LEARNED = "runs/learned/double_pendulum/policy.pt"


@dataclass(frozen=True, eq=False)
class Problem:
    """A robot and its experience.

    Args:
        experiment: of the robot.
        motion: actions (N, F) at states (N, D), one step after the other, drawn from a generator.
        policy: of which the KL is predicted; None for one that is searched.
    """

    experiment: Task
    motion: Callable[[torch.Generator], Callable[[Tensor], Tensor]]
    policy: RBFPolicy | None

    @torch.no_grad()
    def data(self, n: int, seed: int, noise: float) -> tuple[Tensor, Tensor]:
        """Inputs and targets of n transitions of rollouts from fresh starts."""
        task, generator = self.experiment, torch.Generator().manual_seed(seed)
        env = task.make_env(num_envs=-(-n // task.horizon), seed=seed)
        state, motion, parts = env.reset()["observation"], self.motion(generator), []
        for _ in range(task.horizon):
            action = motion(state).clamp(task.actions.low, task.actions.high)
            after = env.simulate(state, action)
            parts.append((state, action, after))
            state = after
        states, actions, successors = (
            torch.stack(part, 1).flatten(0, 1)[:n] for part in zip(*parts, strict=True)
        )
        learned = task.make_dynamics().targets
        inputs, targets = gp_data(states, actions, successors, task.space, learned)
        white = torch.randn(targets.shape, generator=generator, dtype=targets.dtype)
        return inputs, targets + noise * targets.std(0) * white

    def model(self, most_exact: int, tied: bool = False) -> GPDynamics:
        """A model without data, of exact posteriors up to as many."""
        like = self.experiment.make_dynamics()
        size = like.num_inputs, like.num_outputs, like.targets
        return GPDynamics(*size, most_exact=most_exact, tied_lengthscales=tied)

    def evaluation(self, policy: RBFPolicy, dynamics: GPDynamics) -> Callable[[], object]:
        """The KL of the policy with its gradient."""
        loss, parameters = self.experiment.make_loss(policy, dynamics), list(policy.parameters())
        initial = self.experiment.initial
        return lambda: torch.autograd.grad(loss.per_step(initial).sum(), parameters)


def ur5e() -> Problem:
    """The six-joint arm, with random targets along the demonstrations."""
    task = arm_experiment(UR5E)
    return Problem(task, task.exploration.motion, None)


def double_pendulum() -> Problem:
    """The pendulum, with random torques around those of the policy that comes with the package."""
    task = load_experiment("double_pendulum")
    policy = load_policy(resources.files("torch_pmil") / LEARNED)
    actions = task.actions

    def motion(generator: torch.Generator) -> Callable[[Tensor], Tensor]:
        still = torch.zeros_like(actions.middle)
        added = RandomActions(actions, RANDOM_TORQUE, task.horizon, around=still).motion(generator)
        return lambda state: policy(state) + added(state)

    return Problem(task, motion, policy.policy.requires_grad_(True))


ROBOTS = {"ur5e": ur5e, "double_pendulum": double_pendulum}


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add_json(parser, "sparse")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    source = source_of("sparse")
    rows = []
    for robot, make in ROBOTS.items():
        for noise in NOISES:
            rows.append({"robot": robot, "noise": noise, **measure(make(), noise)})
            print(", ".join(f"{name} {_short(value)}" for name, value in rows[-1].items()))
    headline = {name: value for name, value in rows[0].items() if isinstance(value, float)}
    summary = {"experiment": "sparse", **source, "headline": headline, "rows": rows}
    write_summary(arguments.json, summary)


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def measure(problem: Problem, noise: float) -> dict[str, float]:
    """Costs, KL, coverage, times and memory on one robot, with noise of that size."""
    few, some, many = (problem.model(most_exact=SOME) for _ in range(3))
    data = problem.data(MANY, 1, noise)
    forget_peak()
    before, start = memory_mb("VmRSS"), time.process_time()
    many.fit(*data)
    expansion = many.expansion
    fit_seconds, peak = time.process_time() - start, memory_mb("VmHWM") - before
    others = problem.data(TESTED, 2, noise)
    few.fit(*problem.data(FEW, 3, noise))
    some.fit(*problem.data(SOME, 4, noise))
    sparse = problem.model(most_exact=SOME - 1)
    sparse.load_state_dict(some.state_dict())
    policy = problem.policy or searched(problem, sparse)
    exact_kl, sparse_kl = (kl(problem, policy, dynamics) for dynamics in (some, sparse))
    work = [problem.evaluation(policy, dynamics) for dynamics in (few, many)]
    times = [[cpu_seconds(evaluate) for evaluate in work] for _ in range(REPEATS + 1)]
    exact_seconds, sparse_seconds = (min(column) for column in zip(*times[1:], strict=True))
    return {
        "cost_ratio_n5000": sparse_seconds / exact_seconds,
        "kl_difference_n1000": abs(sparse_kl - exact_kl) / exact_kl,
        "coverage_n5000": covered(many, *others),
        "coverage_exact_n1000": covered(some, *others),
        "fit_cpu_seconds_n5000": fit_seconds,
        "fit_peak_mb_n5000": peak,
        "kl_exact_n1000": exact_kl,
        "kl_sparse_n1000": sparse_kl,
        "cpu_seconds_exact_n200": exact_seconds,
        "cpu_seconds_sparse_n5000": sparse_seconds,
        "inducing_inputs": len(expansion.inputs),
    }


def searched(problem: Problem, dynamics: GPDynamics) -> RBFPolicy:
    """The policy of a search on the model, from the experiment's first policy."""
    task = problem.experiment
    policy = task.make_policy(torch.Generator().manual_seed(0))
    search_policy(task.make_loss(policy, dynamics), task.initial, task.method.search)
    return policy


@torch.no_grad()
def kl(problem: Problem, policy: RBFPolicy, dynamics: GPDynamics) -> float:
    """The predicted loss of the policy, nats."""
    task = problem.experiment
    return task.make_loss(policy, dynamics).per_step(task.initial).sum().item()


def covered(dynamics: GPDynamics, inputs: Tensor, targets: Tensor) -> float:
    """Share of targets within two predicted standard deviations, noise included."""
    mean, variance = dynamics.expansion.predict(inputs)
    apart = (targets - mean).square() / (variance + dynamics.expansion.noise)
    return (apart <= 4).double().mean().item()


if __name__ == "__main__":
    main()
