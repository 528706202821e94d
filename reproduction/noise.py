"""The double pendulum with noisy sensors: 0.05 rad and 0.5 rad/s, at each step anew.

Policy and model see the readings alone. Success is that of the saved policies from fresh starts, by
the true states. The model of all experience then predicts 1, 5, 10 and 25 steps of the saved policy
from the readings of fresh rollouts, and is compared with the readings there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean

import numpy as np

from reproduction.delay_calibration import AHEAD, CALIBRATION, STARTS, calibrations, rows_of
from reproduction.remembering import needed_runs, results_of
from reproduction.reproduction import PaperExperiment, Results
from reproduction.robustness import with_noise
from torch_pmil.experiments.tasks.experiment import Experiment
from torch_pmil.plotting.calibration import plot_calibration_ahead

NOISE_STD = 0.05  # rad


def noisy() -> dict[str, Experiment]:
    """The robot with noisy sensors, by its name in the figure.

    Example:
        >>> (task,) = noisy().values()
        >>> task.name
        'double_pendulum_noisy'
    """
    return {"noisy sensors": replace(with_noise(NOISE_STD), name="double_pendulum_noisy")}


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Success over experience and of the saved policies, and calibration over the steps ahead."""
    found = results_of(noisy, "noise", folders, quick)
    ((label, task),) = noisy().items()
    calibrated = [calibrations(folder, task, 5 if quick else STARTS) for folder in folders]
    values = {
        quantity: np.array(
            [[getattr(run[steps], quantity) for steps in AHEAD] for run in calibrated]
        )
        for quantity in CALIBRATION
    }
    means = {
        f"{quantity}_{steps}_ahead": fmean(values[quantity][:, column])
        for quantity in CALIBRATION
        for column, steps in enumerate(AHEAD)
    }
    details = {"calibration": [rows_of(run) for run in calibrated]}
    figure = plot_calibration_ahead(AHEAD, {label: values})
    return Results(
        {**found.headline, **means},
        {**found.figures, "noise_calibration": figure},
        {**found.details, **details},
    )


NOISE = PaperExperiment(
    "noise", "the double pendulum with noisy sensors", partial(needed_runs, noisy), results
)
