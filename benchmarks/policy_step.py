"""Time of one policy step of the double pendulum: NumPy, PyTorch and exported; one thread.

CPU and wall time of each single call, in microseconds, after a warm-up. The three forms take turns,
so that other load on the machine affects them equally. Under such load the wall time shows how long
a step had to wait.

Example:
    python -m benchmarks.policy_step --steps 10000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable

import numpy as np
import torch

from benchmarks.command_line import add_json, source_of, write_summary
from torch_pmil.control.policy_file import load_policy, save_policy
from torch_pmil.tasks.registry import load_experiment

WARM_UP = 100  # steps that are not counted


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=10_000, help="counted for each form")
    add_json(parser, "policy_step")
    arguments = parser.parse_args()
    if arguments.steps < 1:
        parser.error(f"steps must be at least 1, got {arguments.steps}")
    torch.set_num_threads(1)
    source = source_of("policy_step")
    rows = measure(arguments.steps)
    write_summary(arguments.json, {**source, "steps": arguments.steps, "rows": rows})
    print("\n".join(table(rows)))


def measure(steps: int) -> list[dict[str, object]]:
    """A row for each form, with CPU and wall times in microseconds.

    These are the least and the median CPU time, and the median and 99th percentile of the wall
    time.
    """
    forms = make_forms()
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in forms}
    for _ in range(WARM_UP + steps):
        for name, step in forms.items():
            times[name].append(timed(step))
    return [
        {"form": name, **statistics_of(1e6 * np.array(values[WARM_UP:]))}
        for name, values in times.items()
    ]


def timed(step: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall seconds of a step."""
    wall, cpu = time.perf_counter(), time.process_time()
    step()
    return time.process_time() - cpu, time.perf_counter() - wall


def statistics_of(microseconds: np.ndarray) -> dict[str, float]:
    """The entries of a row, given CPU and wall times (steps, 2)."""
    cpu, wall = microseconds.T
    values = {"cpu_us_min": cpu.min(), "cpu_us_median": np.median(cpu)}
    values |= {"wall_us_median": np.median(wall), "wall_us_99_percent": np.percentile(wall, 99)}
    return {name: round(float(value), 1) for name, value in values.items()}


def make_forms() -> dict[str, Callable[[], object]]:
    """One step of a new policy, saved and loaded, in each form."""
    experiment = load_experiment("double_pendulum")
    network = experiment.make_policy(torch.Generator().manual_seed(0))
    with tempfile.TemporaryDirectory() as folder:
        save_policy(
            f"{folder}/policy.pt", network, experiment.space, experiment.demonstrations.time_step
        )
        policy = load_policy(f"{folder}/policy.pt")
        policy.export(f"{folder}/policy.pt2")
        program = torch.export.load(f"{folder}/policy.pt2").module()
    state = experiment.initial.mean
    array = state.numpy()
    return {
        "numpy": lambda: policy(array),
        "torch": lambda: policy(state),
        "exported": lambda: program(state),
    }


def table(rows: list[dict[str, object]]) -> list[str]:
    """Lines of the printed table."""
    lines = [
        f"{'form':<9} {'CPU least':>10} {'median':>10} {'wall median':>12} {'99 %':>10}  "
        "(microseconds)"
    ]
    for row in rows:
        lines.append(
            f"{row['form']:<9} {row['cpu_us_min']:>10.1f} {row['cpu_us_median']:>10.1f} "
            f"{row['wall_us_median']:>12.1f} {row['wall_us_99_percent']:>10.1f}"
        )
    return lines


if __name__ == "__main__":
    main()
