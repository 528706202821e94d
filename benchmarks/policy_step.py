"""Time of one step of the double pendulum's policy, from a state to a torque: NumPy, PyTorch and exported; one thread.

Wall time of each single call on the CPU, in microseconds, after some that are not counted. The three forms take turns, so that what else
the machine does meets all of them.

Example:
    python -m benchmarks.policy_step --steps 10000
"""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.training import provenance
from torch_pmil.files import write_json
from torch_pmil.saved_policy import load_policy, save_policy

WARM_UP = 100  # steps that are not counted


def main() -> None:
    """Read the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=10_000, help="counted for each form")
    parser.add_argument("--json", type=Path, default=Path("results/policy_step/summary.json"), help="file to write")
    arguments = parser.parse_args()
    if arguments.steps < 1:
        parser.error(f"steps must be at least 1, got {arguments.steps}")
    torch.set_num_threads(1)
    source = provenance(shlex.join(["python", "-m", "benchmarks.policy_step", *sys.argv[1:]]))
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    rows = measure(arguments.steps)
    write_json(arguments.json, {**source, "steps": arguments.steps, "rows": rows})
    print("\n".join(table(rows)))


def measure(steps: int) -> list[dict[str, object]]:
    """A row for each form: the least, the median, the 99th percentile and the most, in microseconds."""
    forms = make_forms()
    times: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(WARM_UP + steps):
        for name, step in forms.items():
            start = time.perf_counter()
            step()
            times[name].append(time.perf_counter() - start)
    points = {"us_min": 0, "us_median": 50, "us_99_percent": 99, "us_max": 100}
    return [
        {"form": name, **{point: round(1e6 * np.percentile(values[WARM_UP:], q), 1) for point, q in points.items()}}
        for name, values in times.items()
    ]


def make_forms() -> dict[str, Callable[[], object]]:
    """One step of a new policy, saved and loaded, in each form."""
    experiment = load_experiment("double_pendulum")
    network = experiment.make_policy(torch.Generator().manual_seed(0))
    with tempfile.TemporaryDirectory() as folder:
        save_policy(f"{folder}/policy.pt", network, experiment.space, experiment.demonstrations.time_step)
        policy = load_policy(f"{folder}/policy.pt")
        policy.export(f"{folder}/policy.pt2")
        program = torch.export.load(f"{folder}/policy.pt2").module()
    state = experiment.initial.mean
    array = state.numpy()
    return {"numpy": lambda: policy(array), "torch": lambda: policy(state), "exported": lambda: program(state)}


def table(rows: list[dict[str, object]]) -> list[str]:
    """Lines for the eye."""
    lines = [f"{'form':<9} {'least':>8} {'median':>8} {'99 %':>8} {'most':>8}  (microseconds)"]
    for row in rows:
        lines.append(f"{row['form']:<9} " + " ".join(f"{value:>8.1f}" for value in list(row.values())[1:]))
    return lines


if __name__ == "__main__":
    main()
