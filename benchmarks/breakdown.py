"""CPU time of the parts of one KL with its policy gradient, for several numbers n of data.

One process, one thread. It is evaluated as a policy search does, and the fastest evaluation counts.
Calls of kernels are timed where they are made; the remaining time is Python's. The parts of the
prediction are measured separately between the evaluations, at the beliefs that occurred, and the
fastest of each counts. ``PARTS`` lists both kinds.

Example:
    python -m benchmarks.breakdown --sizes 50 100 200 400 1000
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import NamedTuple
from unittest import mock

import numpy as np
import torch

from benchmarks.command_line import add_json, cpu_seconds, source_of, write_summary
from benchmarks.workloads import make_problem
from torch_pmil.model.compiled import objective
from torch_pmil.model.compiled.arrays import Functions, Record, Workspace
from torch_pmil.model.compiled.building import Address, Array2, Array3, Kernel, call
from torch_pmil.model.compiled.pair_sums import sum_own_pairs, sum_pairs
from torch_pmil.model.compiled.small_matrices import copy
from torch_pmil.model.compiled.trajectory import Robot, StepWork, Tape, write_features, write_inputs

HORIZON = 25
PARTS = {
    "whole": "value and gradient",
    "prediction": "the kernel that predicts T steps",
    "model": "of that, the moments of the model, measured by themselves",
    "pairs of data": "of these, the sums over all pairs of data, measured by themselves, O(n^2)",
    "policy": "of the prediction, the moments of the policy's network, measured by themselves",
    "adjoint": "the kernel that goes the steps back",
    "costs": "the kernel that compares the prediction with the demonstrations",
    "Python": "the rest: the policy and its gradient handed over",
}
KERNELS = {"predict": "prediction", "adjoint": "adjoint", "write_costs": "costs"}


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=int,
        default=[50, 100, 200, 400, 1000],
        metavar="N",
        help="numbers n of data",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=4.0,
        metavar="S",
        help="for which a number of data is measured",
    )
    add_json(parser, "breakdown")
    arguments = parser.parse_args()
    source = source_of("breakdown")
    torch.set_num_threads(1)
    rows = [
        {"n": n, "horizon": HORIZON, "cpu_ms": measure(n, arguments.seconds)}
        for n in arguments.sizes
    ]
    write_summary(arguments.json, {**source, "parts": PARTS, "rows": rows})
    print("\n".join(table(rows)))


def measure(n: int, limit: float) -> dict[str, float]:
    """Milliseconds of each part of the benchmark's problem, measured for so many seconds."""
    evaluate, calls = evaluation(n), Calls()
    with calls.watched():
        evaluate()
        repeated = within(*calls.arguments["prediction"])
        evaluations, others, end = [], [], time.process_time() + limit
        while time.process_time() < end:
            evaluations.append(calls.of(evaluate))
            others.append({part: cpu_seconds(function) for part, function in repeated.items()})
    parts = min(evaluations, key=lambda times: times["whole"])
    parts |= {part: min(times[part] for times in others) for part in repeated}
    return {part: round(1e3 * parts[part], 3) for part in PARTS}


def evaluation(n: int) -> Callable[[], object]:
    """A function that computes value and gradient of the benchmark's problem."""
    problem = make_problem(n, HORIZON)
    loss, policy = problem.loss, problem.policy
    of_policy = loss.objective(loss.per_step, problem.experiment.initial, HORIZON)
    assert of_policy is not None
    return lambda: of_policy((policy.centres, policy.weights, policy.log_widths))


class Calls:
    """CPU time and last arguments of the calls of kernels."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.arguments: dict[str, tuple] = {}

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Time the calls of kernels meanwhile."""
        with contextlib.ExitStack() as stack:
            for name, part in KERNELS.items():
                timed = self.timed(getattr(objective, name), part)
                stack.enter_context(mock.patch.object(objective, name, timed))
            yield

    def timed(self, kernel: Callable[..., object], part: str) -> Callable[..., object]:
        """A kernel that adds to the time of a part."""

        def call_kernel(*arguments: object) -> object:
            self.arguments[part] = arguments
            start = time.process_time()
            result = kernel(*arguments)
            self.seconds[part] += time.process_time() - start
            return result

        return call_kernel

    def of(self, evaluate: Callable[[], object]) -> dict[str, float]:
        """Seconds of one evaluation, of its kernels, and of the rest."""
        self.seconds.clear()
        whole = cpu_seconds(evaluate)
        return {**self.seconds, "whole": whole, "Python": whole - sum(self.seconds.values())}


class Beliefs(NamedTuple):
    """Means (T, D) and covariances (T, D, D) that moments are computed at."""

    means: Array2
    covs: Array3

    @classmethod
    def of(cls, f: Functions) -> Beliefs:
        """Room for the inputs of these functions."""
        D = len(f.inputs)
        return cls(np.empty((HORIZON, D)), np.empty((HORIZON, D, D)))


def within(robot: Robot, tape: Tape, work: StepWork) -> dict[str, Callable[[], object]]:
    """Functions that compute the moments of all steps once more, and the sums in them."""
    of_network, of_model = Beliefs.of(robot.network), Beliefs.of(robot.model)
    record_beliefs(robot, tape, work, of_network, of_model)
    address, change, raw = robot.steps.match, work.change.cov, work.raw.cov
    return {
        "model": lambda: match_steps(
            address, robot.model, of_model, tape.of_model, work.of_model, change
        ),
        "pairs of data": lambda: sum_all_pairs(robot.model, HORIZON, work.of_model),
        "policy": lambda: match_steps(
            address, robot.network, of_network, tape.of_network, work.of_network, raw
        ),
    }


@Kernel
def record_beliefs(
    robot: Robot, tape: Tape, work: StepWork, of_network: Beliefs, of_model: Beliefs
) -> bool:
    """Beliefs over the inputs of the policy and of the model at the states on a tape."""
    for t in range(len(tape.raw_cov)):
        write_features(robot, tape.mean[t], tape.cov[t], work)
        write_inputs(robot, tape, t, work)
        copy(work.features.cov, of_network.covs[t])
        copy(work.inputs.cov, of_model.covs[t])
        for d in range(len(work.features.mean)):
            of_network.means[t, d] = work.features.mean[d]
        for d in range(len(work.inputs.mean)):
            of_model.means[t, d] = work.inputs.mean[d]
    return True


@Kernel
def match_steps(
    match: Address, f: Functions, at: Beliefs, record: Record, work: Workspace, cov: Array2
) -> bool:
    """Moments of the functions at all beliefs."""
    for t in range(len(at.means)):
        if not call(match, (f, at.means[t], at.covs[t], record, t, work, cov)):
            return False
    return True


@Kernel
def sum_all_pairs(f: Functions, steps: int, work: Workspace) -> bool:
    """The sums over pairs of data of all pairs of outputs, at the last belief over and over."""
    for _ in range(steps):
        for a in range(len(f.weights)):
            own, right = f.own_weights[a], work.right
            sum_own_pairs(work.points, right, work.f, own, work.left, work.rows)
            for b in range(a + 1, len(f.weights)):
                w, z = f.weights[a], f.weights[b]
                sum_pairs(work.points, right, work.f, work.g, w, z, work.left, work.rows)
    return True


def table(rows: list[dict]) -> list[str]:
    """Lines of the printed table."""
    header = "".join(f"{'n = ' + str(row['n']):>10}" for row in rows)
    return [f"{'CPU ms':<18}{header}"] + [
        f"{part:<18}" + "".join(f"{row['cpu_ms'][part]:>10.2f}" for row in rows) for part in PARTS
    ]


if __name__ == "__main__":
    main()
