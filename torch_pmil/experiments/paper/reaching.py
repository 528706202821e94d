"""Section 5.2.5's method on another robot: one policy of the double pendulum reaches places with its tip; three seeds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torch_pmil.envs.reaching import COLUMNS, ROWS
from torch_pmil.experiments.double_pendulum_targets import distance_of_tip
from torch_pmil.experiments.paper.reproduction import PaperExperiment, Report, Run
from torch_pmil.experiments.paper.target_study import TargetStudy

PLACES = TargetStudy(
    name="reaching",
    experiment="double_pendulum_targets",
    columns=COLUMNS.tolist(),
    rows=ROWS.tolist(),
    trials=12,
    value=distance_of_tip,
    labels=("x (m)", "y (m)", "largest distance in the last 0.5 s (m)"),
    seeds=range(3),
)


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """As ``scripts/train.py experiment=double_pendulum_targets`` learns, and what comes of each at every place."""
    return (PLACES.quick if quick else PLACES).needed_runs(root)


def report(folders: Sequence[Path], quick: bool) -> Report:
    """What is reached."""
    return PLACES.report(folders)


REACHING = PaperExperiment("reaching", "one policy of the double pendulum reaches places, as in Section 5.2.5", needed_runs, report)
