"""The double pendulum with noisy sensors: 0.05 rad and 0.5 rad/s, at each step anew.

Policy and model see the last three readings, with the torques between them, or the last reading
alone. Success is that of the saved policies from fresh starts, by the true states. The model of all
experience then predicts 1, 5, 10 and 25 steps of the saved policy from the states of fresh
rollouts, and is compared with the readings there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from reproduction.delay_calibration import AHEAD, CALIBRATION, STARTS, calibrations, rows_of
from reproduction.remembering import needed_runs, results_of
from reproduction.reproduction import PaperExperiment, Results
from reproduction.robustness import with_noise
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history

NOISE_STD = 0.05  # rad
PAST = 2  # readings and torques before the last ones


def noisy() -> dict[str, Task]:
    """The robot with noisy sensors, with and without a history, by its name in the figure.

    Example:
        >>> [task.space.dim for task in noisy().values()]
        [16, 4]
    """
    plain = replace(with_noise(NOISE_STD), name="double_pendulum_noisy")
    remembering = with_history(plain, past_entries=PAST, past_actions=PAST)
    name = f"{plain.name}_remembered"
    return {
        "three readings": replace(remembering.with_settings(tied_lengthscales=True), name=name),
        "one reading": plain,
    }


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience and of the saved policies, and calibration over the steps ahead."""
    known, starts = noisy(), 5 if quick else STARTS
    found, each = results_of(noisy, "noise", folders, quick), len(folders) // len(known)
    headline, details = dict(found.headline), []
    for number, task in enumerate(known.values()):
        own = folders[number * each : (number + 1) * each]
        runs = [calibrations(folder, task, starts) for folder in own]
        details += [rows_of(run) for run in runs]
        end = f"_{task.name}" if number else ""
        headline |= {
            f"{quantity}_{steps}_ahead{end}": float(
                np.mean([getattr(run[steps], quantity) for run in runs])
            )
            for quantity in CALIBRATION
            for steps in AHEAD
        }
    return Results(headline, found.figures, {**found.details, "calibration": details})


NOISE = PaperExperiment(
    "noise", "the double pendulum with noisy sensors", partial(needed_runs, noisy), results
)
