"""CPU time of a whole run of ``pmil train`` by part, and its peak of memory.

A part's time is its own: what it spends in another part counts there. Each run has a process and a
new folder of its own. That of the median time counts.

Example:
    python -m benchmarks.run --experiment double_pendulum
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

PARTS = {
    "imports": "from the start of Python to the first line of pmil train",
    "fits": "hyper-parameters and posteriors of the models",
    "kernels": "compiled predictions, costs and adjoints",
    "around": "the rest of an evaluation in a policy search",
    "optimiser": "torch.optim.LBFGS in a policy search",
    "samples": "searches on samples, their kernels left out: costs, gradients and Adam",
    "rollouts": "the robot's motions, simulated",
    "pictures": "figures, video, GIF and report, ffmpeg included",
    "rest": "checkpoints, predictions of success, diagnosis, summaries",
}
WATCHED = (
    ("torch_pmil.model.dynamics", "GPDynamics", "fit", "fits"),
    ("torch_pmil.model.compiled.building", "Kernel", "__call__", "kernels"),
    ("torch_pmil.search.policy_search", "", "minimise_function", "optimiser"),
    ("torch_pmil.search.sample_search", "", "search_on_samples", "samples"),
    ("torchrl.envs", "EnvBase", "rollout", "rollouts"),
    ("torch_pmil.cli.train", "", "tell_all", "pictures"),
)
SEED, REPEATS = 0, 3


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--experiment", default="double_pendulum", help="of pmil train")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument(
        "--json", default=Path("results/benchmarks/run/summary.json"), type=Path, help="to write"
    )
    arguments = parser.parse_args()
    if arguments.alone:
        print(json.dumps(parts_of(arguments.experiment)))
        return
    # not in the process that is measured, whose imports count
    from benchmarks.command_line import row_of_own_process, source_of, write_summary

    source = source_of("run")
    words = ["--alone", "--experiment", arguments.experiment]
    rows = [row_of_own_process("run", *words) for _ in range(REPEATS)]
    headline = sorted(rows, key=lambda row: row["cpu_seconds_total"])[REPEATS // 2]
    write_summary(
        arguments.json,
        {**source, "headline": headline, "parts": PARTS, "rows": rows},
    )
    print("\n".join(f"{name:24s} {value:8.1f}" for name, value in headline.items()))


def parts_of(experiment: str) -> dict[str, float]:
    """CPU seconds of each part of one run, their sum, and the peak of memory in MB."""
    train = import_module("torch_pmil.cli.train")
    for module, *_ in WATCHED:
        import_module(module)
    clock = Clock()
    with TemporaryDirectory() as folder, ExitStack() as stack:
        for module, owner, name, part in WATCHED:
            holder = getattr(import_module(module), owner) if owner else import_module(module)
            timed = clock.timed(part, getattr(holder, name))
            stack.enter_context(mock.patch.object(holder, name, timed))
        stack.enter_context(around_timed(clock))
        words = [f"experiment={experiment}", f"seed={SEED}", f"out={folder}/run"]
        stack.enter_context(mock.patch.object(sys, "argv", ["pmil train", *words]))
        train.main()
    clock.enter("rest")
    seconds = {f"cpu_seconds_{part}": round(clock.seconds[part], 2) for part in PARTS}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    total = round(sum(clock.seconds.values()), 2)
    return {"cpu_seconds_total": total, **seconds, "peak_mb": round(peak)}


class Clock:
    """CPU time of the parts, of which one is entered at a time."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.part, self.since = "imports", 0.0
        self.enter("rest")

    def enter(self, part: str) -> str:
        """Go over to another part, and return the one that is left."""
        left, now = self.part, cpu_seconds()
        self.seconds[left] += now - self.since
        self.part, self.since = part, now
        return left

    @contextmanager
    def inside(self, part: str) -> Iterator[None]:
        """Count the block as this part."""
        left = self.enter(part)
        try:
            yield
        finally:
            self.enter(left)

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function that counts as a part."""

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            with self.inside(part):
                return function(*arguments, **named)

        return call


@contextmanager
def around_timed(clock: Clock) -> Iterator[None]:
    """Count what a search minimises as ``around``."""
    loss = import_module("torch_pmil.search.reparameterisation").ReparameterisedLoss
    original = loss.as_function

    def as_function(*arguments: Any) -> Callable[..., Any]:
        with clock.inside("around"):
            return clock.timed("around", original(*arguments))

    with mock.patch.object(loss, "as_function", as_function):
        yield


def cpu_seconds() -> float:
    """Of this process and of those that it waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


if __name__ == "__main__":
    main()
