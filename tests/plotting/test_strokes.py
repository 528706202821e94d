"""Strokes in the plane: what is drawn is what was given."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.helpers.figures import legend_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting import plot_writing

LINE = torch.tensor([[0.0, 0.0], [0.1, 0.2], [0.3, 0.1]], dtype=torch.float64)


def writing(cov: torch.Tensor) -> tuple[torch.Tensor, Gaussian, torch.Tensor]:
    predicted = Gaussian(LINE[1:], cov.expand(2, 2, 2))
    return LINE.expand(7, 3, 2), predicted, 2 * LINE.expand(20, 3, 2)


@pytest.mark.parametrize("angle", [0.0, 30.0, 100.0])
def test_ellipses_are_two_standard_deviations_along_the_axes_of_the_covariance(
    angle: float,
) -> None:
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    axes = torch.tensor([[cos, -sin], [sin, cos]])
    variances = torch.tensor([0.03, 0.01], dtype=torch.float64) ** 2
    panel = plot_writing({"": writing(axes @ variances.diag() @ axes.mT)}).axes[0]
    (ellipses,) = panel.collections
    np.testing.assert_allclose(ellipses.get_widths(), 4 * 0.03, rtol=1e-6)
    np.testing.assert_allclose(ellipses.get_heights(), 4 * 0.01, rtol=1e-6)
    np.testing.assert_allclose(np.mod(ellipses.get_angles(), 180), angle, atol=1e-4)
    np.testing.assert_allclose(ellipses.get_offsets(), LINE[1:])


def test_every_stroke_of_people_is_a_line_few_of_the_robot_are_and_every_task_a_panel() -> None:
    figure = plot_writing({name: writing(torch.eye(2, dtype=torch.float64)) for name in "abc"})
    assert [panel.get_title() for panel in figure.axes] == ["a", "b", "c"]
    for panel in figure.axes:
        assert len(panel.lines) == 7 + 1 + 5
        np.testing.assert_allclose(panel.lines[0].get_xydata(), LINE)
        np.testing.assert_allclose(panel.lines[-1].get_xydata(), 2 * LINE)
    assert legend_of(figure)[::2] == ["7 strokes of people", "robot: the first 5 of 20 rollouts"]
