"""Counts of what left the limits, and the figure of it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from reproduction.box import SEEDS, TRIALS, _excursions, needed_runs, with_box
from reproduction.plots.excursions import plot_excursions
from torch_pmil.control.state_box import StateBox


@pytest.fixture
def box() -> StateBox:
    box = with_box().state_box
    assert box is not None
    return box


def test_limits_are_above_the_demonstrated_speeds(box: StateBox) -> None:
    states = with_box().demonstrated_states
    assert set(box.limits) == {"dq1", "dq2"}
    for name, index in (("dq1", 1), ("dq2", 3)):
        low, high = box.limits[name]
        assert high == -low == pytest.approx(1.3 * states[:, index].abs().max().item())


def test_excursions_are_those_of_each_rollout(box: StateBox) -> None:
    """Two rollouts of 2 and 3 transitions; the second one is outside in two of them."""
    speed = box.limits["dq2"][1] * torch.tensor([0.0, 0.2, -0.5, 0.1, 1.5, 0.9, -3.0]).double()
    states = torch.zeros(7, 4, dtype=torch.float64)
    states[:, 3] = speed
    before, after = states[[0, 1, 3, 4, 5]], states[[1, 2, 4, 5, 6]]
    found = _excursions(before, after, box, period=0.1)
    np.testing.assert_allclose(found.ends_s, [0.2, 0.5])
    np.testing.assert_allclose(found.furthest, [0.5, 3.0])
    assert (found.transitions, found.rollouts) == (2, 1)


def test_runs_are_the_same_seeds_with_and_without(tmp_path) -> None:
    names = [str(run.out.relative_to(tmp_path)) for run in needed_runs(tmp_path, quick=False)]
    without = [f"double_pendulum/seed_{seed}" for seed in SEEDS]
    assert names == without + [name.replace("pendulum", "pendulum_box") for name in without]
    assert list(TRIALS) == ["without", "with"]


def test_figure_fills_what_left() -> None:
    runs = {"a": [(np.array([1.0, 2.0]), np.array([3.0, 0.5]))], "b": []}
    figure = plot_excursions(runs, "speed")
    _, course, outside, inside = figure.axes[0].lines
    assert course.get_xydata().tolist() == [[1.0, 3.0], [2.0, 0.5]]
    assert outside.get_xydata().tolist() == [[1.0, 3.0]]
    assert outside.get_markerfacecolor() == outside.get_color()
    assert inside.get_xydata().tolist() == [[2.0, 0.5]]
    assert inside.get_markerfacecolor() == "white"
    with pytest.raises(ValueError, match="runs must hold one at least, got none"):
        plot_excursions({}, "speed")
