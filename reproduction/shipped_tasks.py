"""Thirty seeds of the double pendulum and ten of four other tasks, into results/tasks/NAME.

``make results`` is ``python -m reproduction.shipped_tasks``. What was learned with the present
sources is not learned again, and what was stopped goes on.
"""

from __future__ import annotations

from pathlib import Path

from reproduction.reproduction import ends_in_one_line, finish, learning_run, root_of_runs
from torch_pmil.cli.summarize import summarize
from torch_pmil.tasks.registry import load_experiment

SEEDS = {
    "double_pendulum": range(30),
    "double_pendulum_servo": range(10),
    "cart_pole": range(10),
    "gym_pendulum": range(10),
    "inverted_pendulum": range(10),
}
COMMAND = "make results"


def main() -> None:
    """Learn, write, print a table of each task."""
    root = root_of_runs()
    runs = {
        name: [learning_run(root, load_experiment(name), seed) for seed in seeds]
        for name, seeds in SEEDS.items()
    }
    with ends_in_one_line(COMMAND):
        finish([run for of_task in runs.values() for run in of_task], COMMAND)
        for name, of_task in runs.items():
            summarize([run.out for run in of_task], Path("results/tasks", name), COMMAND)


if __name__ == "__main__":
    main()
