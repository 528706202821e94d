"""CPU time of the parts of one KL with its policy gradient, for several numbers n of data.

The parts are timed where they are called, in one process with one thread, and the least of several
evaluations counts for each, so that they need not add up exactly. What a part contains stands in
``PARTS``.

Example:
    python -m benchmarks.breakdown --sizes 50 100 200 400
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import torch

from benchmarks.workloads import make_problem
from torch_pmil.experiments.runs.run_folder import provenance
from torch_pmil.files import write_json
from torch_pmil.gp import moment_derivatives
from torch_pmil.model import rollout

ROOT = Path(__file__).parents[1]
HORIZON = 25
PARTS = {
    "rollout": "the T steps one after the other, all of the following included",
    "pairs of data": "the exponentials of all pairs and their products with thin matrices, O(n^2)",
    "sums": "the sums over the data that derivatives are made of, several steps at once",
    "jacobian": "the Jacobians of all steps, with what was left of the sums",
    "policy gradient": "the policy's moments at all steps once more, and their gradient",
    "whole": "value and gradient, the comparison with the demonstrations included",
}


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=int,
        default=[50, 100, 200, 400],
        metavar="N",
        help="numbers n of data",
    )
    parser.add_argument(
        "--repeats",
        type=int,
        default=30,
        metavar="N",
        help="evaluations, of which the fastest counts",
    )
    parser.add_argument(
        "--json",
        type=Path,
        default=ROOT / "results/benchmarks/prediction/breakdown.json",
        help="to write",
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    clock = Clock()
    clock.watch(rollout, "unroll", "rollout")
    clock.watch(moment_derivatives, "pairwise_kernel_sums", "pairs of data")
    clock.watch(moment_derivatives.RecordedMoments, "_sum_up", "sums")
    clock.watch(rollout._MomentStep, "jacobian", "jacobian")
    clock.watch(rollout._MomentStep, "parameter_gradients", "policy gradient")
    rows = [
        {"n": n, "horizon": HORIZON, "cpu_ms": clock.least(evaluation(n), arguments.repeats)}
        for n in arguments.sizes
    ]
    source = provenance(shlex.join(["python", "-m", "benchmarks.breakdown", *sys.argv[1:]]))
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    write_json(arguments.json, {**source, "parts": PARTS, "rows": rows})
    print("\n".join(table(rows)))


def evaluation(n: int) -> Callable[[], object]:
    """A function that computes value and gradient of the benchmark's problem."""
    problem = make_problem(n, HORIZON)
    loss, parameters = problem.loss, list(problem.policy.parameters())
    return lambda: torch.autograd.grad(loss.per_step(problem.experiment.initial).sum(), parameters)


class Clock:
    """CPU time spent in chosen functions."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def watch(self, owner: object, name: str, part: str) -> None:
        """Time all calls of a function or method from now on."""
        function = getattr(owner, name)

        def timed(*args: object, **kwargs: object) -> object:
            start = time.process_time()
            result = function(*args, **kwargs)
            self.seconds[part] += time.process_time() - start
            return result

        setattr(owner, name, timed)

    def least(self, evaluate: Callable[[], object], repeats: int) -> dict[str, float]:
        """The least milliseconds of each part in several evaluations, the first not counted."""
        evaluate()
        runs = []
        for _ in range(repeats):
            self.seconds.clear()
            start = time.process_time()
            evaluate()
            runs.append({**self.seconds, "whole": time.process_time() - start})
        return {part: round(1e3 * min(run[part] for run in runs), 2) for part in PARTS}


def table(rows: list[dict]) -> list[str]:
    """Lines of the printed table."""
    header = "".join(f"{'n = ' + str(row['n']):>10}" for row in rows)
    return [f"{'CPU ms':<18}{header}"] + [
        f"{part:<18}" + "".join(f"{row['cpu_ms'][part]:>10.1f}" for row in rows) for part in PARTS
    ]


if __name__ == "__main__":
    main()
