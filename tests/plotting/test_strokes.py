"""Strokes in the plane: what is drawn is what was given."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting import plot_writing

LINE = torch.tensor([[0.0, 0.0], [0.1, 0.2], [0.3, 0.1]], dtype=torch.float64)


def writing(cov: torch.Tensor) -> tuple[torch.Tensor, Gaussian, torch.Tensor]:
    return (
        LINE.expand(7, 3, 2),
        Gaussian(LINE[1:], cov.expand(2, 2, 2)),
        2 * LINE.expand(20, 3, 2),
    )


@pytest.mark.parametrize("angle", [0.0, 30.0, 100.0])
def test_ellipses_are_two_standard_deviations_along_the_axes_of_the_covariance(
    angle: float,
) -> None:
    turn = np.radians(angle)
    axes = torch.tensor(
        [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], dtype=torch.float64
    )
    panel = plot_writing(
        {"": writing(axes @ torch.diag(torch.tensor([0.03, 0.01]) ** 2).double() @ axes.mT)}
    ).axes[0]
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
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[::2] == ["7 strokes of people", "robot: the first 5 of 20 rollouts"]
