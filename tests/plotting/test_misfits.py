"""What does not fit into a figure is refused with the shapes that were expected and that came."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from reproduction.plots.gaussian_process import plot_gp, plot_moment_matching
from reproduction.plots.photos import plot_photo_series
from torch_pmil import plotting as p
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics

zeros = torch.zeros
X, Y = np.array([0.0, 0.1, 0.2, 0.3]), np.array([-0.7, -0.6, -0.5])
VALUES, REACHED = np.arange(12.0).reshape(3, 4), np.eye(3, 4, dtype=bool)
TARGETS, PICTURE = np.zeros((2, 2)), np.zeros((8, 8, 3), dtype=np.uint8)
TWO, THREE = np.zeros(2), np.zeros(3)
NAMED = NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))
POLICY = StatePolicy(RBFPolicy(zeros(5, 3), torch.ones(2), torch.ones(3)), SPACE, 0.1)
INPUTS = ("dq (rad/s)", "sin q", "cos q", "u (N·m)")
MODEL = GPDynamics(4, 2)
MODEL.set_data(zeros(3, 4).double(), zeros(3, 2).double())
GRID, SPAN = torch.arange(3.0), ((0.0, 1.0), (0.0, 1.0))


def belief(*shape: int) -> Gaussian:
    return Gaussian(zeros(shape), torch.eye(shape[-1]).expand(*shape, shape[-1]))


def heat_map(
    values: np.ndarray = VALUES,
    reached: np.ndarray = REACHED,
    x: np.ndarray = X,
    targets: np.ndarray = TARGETS,
) -> Figure:
    labels, maps = ("x (m)", "y (m)"), {"ours": (values, reached)}
    return p.plot_heat_map(x, Y, maps, targets, labels=labels, value="distance (m)")


def policy_map(plane: p.Plane, entries: int = 2) -> Figure:
    return p.plot_policy(POLICY, [plane], zeros(1, entries), ["a"])


UNEVEN = "x must be at least two increasing, evenly spaced coordinates, got "
FITTING = r"values and successes of ours must be numbers and bools \(3, 4\), got "
ALLOWED = "values of ours must be finite and not negative, got "
JOINTS = r"joints must have shape \(N, P, 2\), got "
DISTRIBUTIONS = zeros(3, 7, 2), belief(6, 2), belief(5, 2), zeros(2, 7, 2)
MISFITS: list[tuple[Callable[[], object], str]] = [
    (
        lambda: p.plot_distributions(*NAMED, 0.1, *DISTRIBUTIONS),
        r"predicted must be \(6, 2\), .* got \(5, 2\), \(3, 7, 2\) and \(2, 7, 2\)",
    ),
    (
        lambda: p.plot_demonstrations("x", "m", 0.1, zeros(3, 5, 1), belief(5, 1)),
        r"demonstrations must be \(N, 6, 1\) for .* marginals \(5, 1\), .* got \(3, 5, 1\)",
    ),
    (
        lambda: p.plot_prediction("x", "m", 0.1, belief(5, 1), zeros(3, 6, 1)),
        r"be \(N, 5, 1\) with N of at least 2 .* got \(3, 6, 1\), 1 names and 1 units",
    ),
    (
        lambda: p.plot_learning_curve([2.5, 5.0], [0.0], [1.0, 1.0]),
        "must be equally long, got 2, 1, 2",
    ),
    (
        lambda: p.plot_success_over_experience(TWO, np.zeros((1, 3)), THREE, THREE),
        r"must be \(K,\) for rates \(runs, K\), got \(2,\), \(3,\), \(3,\) for \(1, 3\)",
    ),
    (
        lambda: p.plot_success_of_methods({"b": (TWO, THREE, TWO, TWO)}),
        r"experience, mean and interval of b must be equally long, got \[2, 3, 2, 2\]",
    ),
    (lambda: p.plot_poses(zeros(3, 2), 0.1), JOINTS + r"\(3, 2\)"),
    (lambda: next(p.pendulum_frames(zeros(4), 0.1)), JOINTS + r"\(4,\)"),
    (
        lambda: plot_gp(zeros(4), GRID, GRID, belief(3, 1), 0.5),
        r"inputs and targets must be \(n,\) each, got \(4,\) and \(3,\)",
    ),
    (
        lambda: plot_gp(GRID, GRID, GRID, belief(4, 1), 0.5),
        r"posterior must have a mean of shape \(3, 1\), .* got \(4, 1\)",
    ),
    (
        lambda: plot_moment_matching(GRID, belief(3, 1), belief(2), zeros(9), belief(1)),
        r"belief and matched must be of one entry .* \(S,\), got \(2,\), \(1,\) and \(9,\)",
    ),
    (
        lambda: p.plot_gp_slices(MODEL, zeros(3), INPUTS, *NAMED),
        r"must have 4 entries, .* 2, got \(3,\), 4, 2 and 2",
    ),
    (
        lambda: p.plot_gp_slices(MODEL, zeros(4), INPUTS, *NAMED, [4]),
        r"over must be inputs from 0 to 3, got \[4\]",
    ),
    (
        lambda: p.plot_calibration(NAMES, 0.1, zeros(5, 8, 3)),
        r"residuals must be \(N, T, 2\) for q, dq, got \(5, 8, 3\)",
    ),
    (
        lambda: p.plot_kl_per_step(NAMES, 0.1, belief(7, 3), belief(6, 3)),
        r"must be \(T, 2\) for 2 names, got \(7, 3\) and \(6, 3\)",
    ),
    (
        lambda: policy_map(p.Plane(0, 1, 0, SPAN), entries=3),
        r"states must be \(K, 2\) with K titles, got \(1, 3\) and 1 titles",
    ),
    (
        lambda: policy_map(p.Plane(0, 2, 0, SPAN)),
        r"planes must be of entries below 2 and actions below 2, got Plane\(x=0, y=2",
    ),
    (
        lambda: p.plot_recordings(["1"], [GRID], [GRID[:, None]], NAMES),
        "1 labels and 2 names must be those of 1 trajectories of 1",
    ),
    (
        lambda: plot_photo_series({"shown": [PICTURE] * 2, "learned": [PICTURE]}, (0.0, 1.0)),
        "learned must have a picture for each of the 2 times, got 1",
    ),
    (
        lambda: p.plot_heat_map(X, Y, {}, TARGETS, labels=("x", "y"), value="m"),
        "maps must hold one at least, got none",
    ),
    (lambda: heat_map(x=np.array([0.0, 0.1, 0.3, 0.4])), UNEVEN + r"\[0.0, 0.1, 0.3, 0.4\]"),
    (lambda: heat_map(x=X[::-1]), UNEVEN + r"\[0.3,"),
    (lambda: heat_map(x=X[:1]), UNEVEN + r"\[0.0\]"),
    (lambda: heat_map(VALUES.T), FITTING + r"\(4, 3\) and bool"),
    (lambda: heat_map(reached=VALUES), FITTING + r".* and float64 \(3, 4\)"),
    (lambda: heat_map(VALUES - 1), ALLOWED + "-1.0"),
    (lambda: heat_map(VALUES * np.nan), ALLOWED + "nan"),
    (lambda: heat_map(targets=TARGETS[0]), r"training_targets must be \(S, 2\), got \(2,\)"),
    (lambda: heat_map(targets=TARGETS[:0]), r"training_targets must be \(S, 2\), got \(0, 2\)"),
]


@pytest.mark.parametrize(("call", "message"), MISFITS, ids=[row[1] for row in MISFITS])
def test_what_does_not_fit_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_model_without_data_has_no_slices() -> None:
    with pytest.raises(RuntimeError, match="no data"):
        p.plot_gp_slices(GPDynamics(4, 2), zeros(4), INPUTS, *NAMED)
