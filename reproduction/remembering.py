"""The double pendulum by a state that holds the past: without velocity sensors, and with a delay.

Velocities that are not measured follow from the last two positions and the torque between them. A
torque that takes effect 50 or 100 ms late, half a control period or a whole one, is an entry of the
state at the time when it does. Success is that of the saved policies from fresh starts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean

from reproduction.delay_calibration import with_delay
from reproduction.figure7 import GOAL, size, success_curves, success_results
from reproduction.learned import remeasured
from reproduction.reproduction import PaperExperiment, Results, Run, learning_run
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history

Tasks = Callable[[], Mapping[str, Task]]

TRIALS = 11  # 30 s of experience in all, with the first motion
STARTS, START_SEED = 100, 10_000_000  # no start that a run has seen


def positions_only() -> dict[str, Task]:
    """The robot without velocity sensors, by its name in the figure.

    Example:
        >>> (task,) = positions_only().values()
        >>> task.history.hidden, task.make_dynamics().num_outputs
        (('dq1', 'dq2'), 2)
    """
    task = with_history(load_experiment("double_pendulum"), positions_only=True, past_actions=1)
    return {"positions only": replace(task, name="double_pendulum_positions")}


def delayed() -> dict[str, Task]:
    """The robots whose torques take effect late, by their names in the figure.

    Example:
        >>> [task.space.dim for task in delayed().values()]
        [6, 6]
    """
    late = {f"{1000 * delay:g} ms late": with_delay(delay) for delay in (0.1, 0.05)}
    return {
        label: replace(with_history(task, past_actions=1), name=f"{task.name}_remembered")
        for label, task in late.items()
    }


def needed_runs(tasks: Tasks, root: Path, quick: bool) -> list[Run]:
    """Ours on each task, ten seeds each."""
    seeds, trials = size(quick, TRIALS)
    return [learning_run(root, task, seed, trials) for task in tasks().values() for seed in seeds]


def results_of(tasks: Tasks, name: str, folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience and of the saved policies; the first task's have the plain names."""
    known = tasks()
    curves, each = success_curves(folders, list(known)), len(folders) // len(known)
    starts, headline, runs = 20 if quick else STARTS, dict[str, float | None](), []
    for number, (label, task) in enumerate(known.items()):
        own = folders[number * each : (number + 1) * each]
        measured = [remeasured(folder, task, starts, START_SEED) for folder in own]
        rates, end = [run["success_rate"] for run in measured], f"_{task.name}" if number else ""
        headline |= {
            f"seeds_at_95{end}": sum(rate >= GOAL for rate in rates),
            f"mean_saved_success_rate{end}": fmean(rates),
            f"least_saved_success_rate{end}": min(rates),
            f"experience_to_95{end}": curves[label].experience_to(GOAL),
            f"max_experience_s{end}": max(run["experience_s"] for run in measured),
        }
        runs += measured
    made = success_results(curves, {"seeds": each, **headline}, name)
    return replace(made, details={**made.details, "starts": starts, "measured": runs})


POSITIONS_ONLY = PaperExperiment(
    "positions_only",
    "the double pendulum without velocity sensors",
    partial(needed_runs, positions_only),
    partial(results_of, positions_only, "positions_only"),
)
DELAY = PaperExperiment(
    "delay",
    "the double pendulum with a delay that its state remembers",
    partial(needed_runs, delayed),
    partial(results_of, delayed, "delay"),
)
