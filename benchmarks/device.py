"""A GPU beside one core of the CPU: time of a prediction with its policy gradient.

On the problem of ``benchmarks.breakdown``, by moments and by 100 and 1000 functions. On the CPU the
compiled kernels compute them in one thread, on the GPU the formulas in PyTorch. Wall time, since a
GPU has no CPU time; the median of several evaluations.

Example:
    python -m benchmarks.device
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median

import torch

from benchmarks.breakdown import HORIZON
from benchmarks.command_line import add_json, source_of, write_summary
from benchmarks.workloads import Problem, make_problem
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.sampled_rollouts import sample_consistent_rollouts

SIZES, FUNCTIONS, REPEATED = (100, 400, 1000), (100, 1000), 5


def main() -> None:
    """Read the command line, measure on both devices, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add_json(parser, "device")
    arguments = parser.parse_args()
    if not torch.cuda.is_available():
        parser.error("a GPU that PyTorch can use must be there, got none")
    source, rows = source_of("device"), dict[str, dict[str, float]]()
    torch.set_num_threads(1)
    gpu = torch.cuda.get_device_name()
    for n in SIZES:
        for device in ("cpu", "cuda"):
            rows[f"{device}_n{n}"] = row = times(n, device)
            print(f"n = {n} on {device}:", row, flush=True)
    write_summary(arguments.json, {**source, "gpu": gpu, "rows": rows})


def times(n: int, device: str) -> dict[str, float]:
    """Milliseconds of each way to predict with n data."""
    problem = make_problem(n, HORIZON)
    initial = problem.experiment.initial
    start = Gaussian(initial.mean.to(device), initial.cov.to(device))
    loss = problem.loss.to(device)
    parameters = list(loss.actor_network.parameters())

    def moments() -> None:
        torch.autograd.grad(loss.per_step(start).sum(), parameters)

    by_count = {count: wall_ms(by_functions(problem, start, count)) for count in FUNCTIONS}
    of_functions = {f"functions_{count}_ms": ms for count, ms in by_count.items()}
    return {"moments_ms": wall_ms(moments)} | of_functions


def by_functions(problem: Problem, start: Gaussian, count: int) -> Callable[[], None]:
    """Draws functions, follows them, and finds a gradient."""
    policy, dynamics, space = problem.policy, problem.dynamics, problem.experiment.space

    def follow() -> None:
        functions = dynamics.functions(count, torch.Generator().manual_seed(0))
        given = count, dynamics, space, HORIZON, torch.Generator().manual_seed(1)
        states = sample_consistent_rollouts(start, policy, functions, *given)
        torch.autograd.grad(states.square().sum(), list(policy.parameters()))

    return follow


def wall_ms(work: Callable[[], None]) -> float:
    """Milliseconds of the median call, after one that may compile."""
    work()
    return round(1e3 * median(wall_seconds(work) for _ in range(REPEATED)), 1)


def wall_seconds(work: Callable[[], None]) -> float:
    """Seconds until the work is done on the GPU too."""
    torch.cuda.synchronize()
    begin = time.perf_counter()
    work()
    torch.cuda.synchronize()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
