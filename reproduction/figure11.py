"""Section 5.2.5, Figure 11: one policy of the BioRob hits balls in a plane; ten seeds."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from reproduction.reproduction import PaperExperiment, Results, Run
from reproduction.target_picture import draw_targets
from reproduction.target_study import TargetStudy
from torch_pmil.envs.hitting_plane import COLUMNS, ROWS
from torch_pmil.tasks.biorob_targets import biorob_targets


def least_distance(rollouts: TensorDictBase) -> Tensor:
    """Least distance (m) of the centres of racket and ball in rollouts: (*batch, T) to (*batch)."""
    return rollouts["next", "info", "centre_distance"][..., 0].amin(-1)


BALLS = TargetStudy(
    name="figure11",
    experiment=biorob_targets,
    columns=COLUMNS,
    rows=ROWS,
    trials=15,
    value=least_distance,
    labels=("y (m)", "z (m)", "least distance of racket and ball (m)"),
    seeds=range(10),
)


def needed_runs(root: Path, quick: bool) -> list[Run]:
    """The runs of ``pmil train experiment=biorob_targets``, measured at every ball of the grid."""
    return (BALLS.quick if quick else BALLS).needed_runs(root)


def results(folders: Sequence[Path], quick: bool) -> Results:
    """Balls that are hit, with the set-up drawn beside them (Figure 11 (a))."""
    return BALLS.results(folders, set_up())


def set_up() -> np.ndarray | None:
    """A picture of the robot and the balls; None, with a warning, without OpenGL."""
    try:
        return draw_targets()
    except RuntimeError as error:
        warnings.warn(
            f"figure 11 has no picture of the set-up: {error}", RuntimeWarning, stacklevel=1
        )
        return None


FIGURE11 = PaperExperiment(
    "figure11", "one policy hits balls in a plane (Section 5.2.5, Figure 11)", needed_runs, results
)
