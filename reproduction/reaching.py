"""Section 5.2.5's method on the double pendulum: its tip reaches places; ten seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from reproduction.reproduction import PaperExperiment, Results, Run
from reproduction.target_study import TargetStudy
from reproduction.teachers.reaching import COLUMNS, ROWS
from torch_pmil.tasks.double_pendulum_targets import (
    distance_of_tip,
    double_pendulum_targets,
)
from torch_pmil.tasks.targets import TargetTask

NARROW = 0.5  # target_scale


def narrow() -> TargetTask:
    """The double pendulum's targets with basis functions that are narrow in the target.

    Their width is half the largest distance between the training targets.
    """
    return replace(
        double_pendulum_targets(), name="double_pendulum_targets_narrow", target_scale=NARROW
    )


PLACES = TargetStudy(
    name="reaching",
    experiment=double_pendulum_targets,
    columns=COLUMNS.tolist(),
    rows=ROWS.tolist(),
    trials=12,
    value=distance_of_tip,
    labels=("x (m)", "y (m)", "largest distance in the last 0.5 s (m)"),
    seeds=range(10),
)
NARROW_PLACES = replace(PLACES, name="reaching_narrow", experiment=narrow)


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The runs of ``pmil train experiment=double_pendulum_targets``, and narrow ones beside.

    Each is measured everywhere on the grid.
    """
    studies = [study.quick if quick else study for study in (PLACES, NARROW_PLACES)]
    return [run for study in studies for run in study.needed_runs(root)]


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Places that are reached, and those that narrow functions reach."""
    half = len(folders) // 2
    wide, thin = PLACES.results(folders[:half]), NARROW_PLACES.results(folders[half:])
    kept = ("training_success_rate", "grid_fraction", "triangle_fraction")
    added = {f"narrow_{name}": thin.headline[name] for name in kept}
    return replace(wide, headline={**wide.headline, **added})


REACHING = PaperExperiment(
    "reaching",
    "one policy of the double pendulum reaches places, as in Section 5.2.5",
    needed_runs,
    results,
)
