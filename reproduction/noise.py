"""Robots with noisy sensors, 0.05 rad and 0.5 rad/s or less, at each step anew.

Policy and model of a double pendulum see the last three readings with the torques between them, or
the last one, or positions alone. Success is that of the saved policies from fresh starts, by the
true states. The model of all experience then predicts 1, 5, 10 and 25 steps of the saved policy
from the states of fresh rollouts, and is compared with the readings there. Policies that see one
reading also act behind a filter (:mod:`reproduction.filtering`). The double pendulum with servos
and the BioRob learn with the same noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean

from reproduction.delay_calibration import AHEAD, CALIBRATION, calibrations, rows_of
from reproduction.filtering import behind_filters
from reproduction.remembering import START_SEED, STARTS, needed_runs, results_of
from reproduction.reproduction import PaperExperiment, Results
from reproduction.robustness import noise_of, with_noise
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history
from torch_pmil.trainer.ending import LIMIT

NOISE_STD, LESS = 0.05, 0.02  # rad
ONE, PLACES = "one reading", f"positions alone, {LESS:g} rad"
PAST = 2  # readings and torques before the last ones
FORESEEN = 20  # rollouts from whose states a model predicts


def noisy() -> dict[str, Task]:
    """The robot with noisy sensors, by its name in the figure.

    Example:
        >>> [task.space.dim for task in noisy().values()]
        [16, 4, 4, 6]
    """
    plain = replace(with_noise(NOISE_STD), name="double_pendulum_noisy")
    less = replace(with_noise(LESS), name="double_pendulum_less_noisy")
    places = with_history(less, positions_only=True, past_actions=1)
    return {
        "three readings": of_three_readings(plain),
        ONE: plain,
        f"one reading, {LESS:g} rad": less,
        PLACES: replace(places, name=f"{less.name}_positions"),
    }


def of_three_readings(task: Task) -> Task:
    """The same task by the last three readings and the actions between them."""
    past = with_history(task, past_entries=PAST, past_actions=PAST)
    return replace(past.with_settings(tied_lengthscales=True), name=f"{task.name}_remembered")


def other_robots() -> dict[str, Task]:
    """Other robots with noisy sensors, by their names in the figure.

    Example:
        >>> [task.space.dim for task in other_robots().values()]
        [4, 16, 6]
    """
    servos, arm = (
        replace(with_noise(NOISE_STD, name), name=f"{name}_noisy")
        for name in ("double_pendulum_servo", "biorob")
    )
    return {"servos": servos, "servos, three readings": of_three_readings(servos), "BioRob": arm}


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience, of the saved policies and behind filters, and calibration."""
    known, starts, foreseen = noisy(), *((20, 5) if quick else (STARTS, FORESEEN))
    found, each = results_of(noisy, "noise", folders, quick), len(folders) // len(known)
    headline, rows = dict(found.headline), []
    measured = found.details["measured"]
    assert isinstance(measured, list)  # a summary of each run
    parts = {label: slice(n * each, (n + 1) * each) for n, label in enumerate(known)}
    for number, (label, task) in enumerate(known.items()):
        own = parts[label]
        runs = [calibrations(folder, task, foreseen) for folder in folders[own]]
        rows += [rows_of(run) for run in runs]
        end = f"_{task.name}" if number else ""
        headline |= {
            f"{quantity}_{steps}_ahead{end}": fmean(getattr(run[steps], quantity) for run in runs)
            for quantity in CALIBRATION
            for steps in AHEAD
        }
        promised = [run for run in measured[own] if run["stop_reason"] != LIMIT]
        kept = [run["success_rate"] >= task.method.ending.promise for run in promised]
        headline |= {f"promised{end}": len(promised), f"promise_kept{end}": sum(kept)}
    task, plain = known[ONE], load_experiment("double_pendulum")
    given = task, plain, noise_of(NOISE_STD, task.space.names), starts, START_SEED
    filtered = [behind_filters(folder, *given) for folder in folders[parts[ONE]]]
    headline |= {
        f"positions_only_{LESS:g}": headline.pop(f"mean_saved_success_rate_{known[PLACES].name}"),
        "limit_success_rate": fmean(run["robot"] for run in filtered),
        "filtered_success_rate": fmean(run["model"] for run in filtered),
        "least_filtered_success_rate": min(run["model"] for run in filtered),
    }
    details = {**found.details, "calibration": rows, "behind_filters": filtered}
    return Results(headline, found.figures, details)


NOISE = PaperExperiment(
    "noise", "the double pendulum with noisy sensors", partial(needed_runs, noisy), results
)
NOISY_ROBOTS = PaperExperiment(
    "noisy_robots",
    "the double pendulum with servos and the BioRob with noisy sensors",
    partial(needed_runs, other_robots),
    partial(results_of, other_robots, "noisy_robots"),
)
