"""Figure of strokes in the plane in which they were written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting.style import (
    BAND,
    BLUE,
    DARK,
    FEW,
    VERMILLION,
    WIDTH,
    check_some,
    legend_above,
    rollouts_of,
    style,
)


def plot_writing(panels: Mapping[str, tuple[Tensor, Gaussian, Tensor]]) -> Figure:
    """Human strokes, the prediction for the learned policy, and the robot's strokes.

    There is one panel for each stroke. The prediction is the outline of an ellipse of two standard
    deviations at each step.

    Args:
        panels: by the title of their panel, strokes of people (N, T + 1, 2), marginals of the tip
            at t = 1..T, mean (T, 2), and strokes of the robot (B, T + 1, 2), of which the first 5
            are drawn; all in m, x to the right and y up.

    Raises:
        ValueError: there is no panel, or shapes do not fit each other.

    Example:
        >>> import torch
        >>> line = torch.linspace(0, 0.3, 5)[:, None].expand(5, 2)
        >>> predicted = Gaussian(line[1:], 1e-4 * torch.eye(2).expand(4, 2, 2))
        >>> plot_writing({"line": (line[None], predicted, line[None])}).axes[0].get_title()
        'line'
    """
    check_some("panels", panels)
    columns = math.ceil(math.sqrt(len(panels)))
    rows = math.ceil(len(panels) / columns)
    height = 0.9 + 3.4 * rows if columns > 1 else 6.2
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    for index, (title, (shown, predicted, written)) in enumerate(panels.items()):
        shapes = tuple(shown.shape[1:]), tuple(written.shape[1:])
        wanted = len(predicted.mean) + 1, 2
        if predicted.mean.shape[1:] != (2,) or shapes != (wanted, wanted):
            raise ValueError(
                f"strokes of {title} must be (N, {wanted[0]}, 2) for marginals ({wanted[0] - 1}, 2)"
                f", got {tuple(shown.shape)} and {tuple(written.shape)} for "
                f"{tuple(predicted.mean.shape)}"
            )
        panel = figure.add_subplot(rows, columns, index + 1)
        _draw(panel, shown, predicted, written)
        panel.set_title(title)
        if index + columns >= len(panels):
            panel.set_xlabel("x (m)")
        if index % columns == 0:
            panel.set_ylabel("y (m)")
    legend_above(figure, 3, panel)
    return figure


def _draw(panel: Axes, shown: Tensor, predicted: Gaussian, written: Tensor) -> None:
    style(panel)
    places: dict[str, Any] = {"units": "xy", "offset_transform": panel.transData}
    places["offsets"] = predicted.mean.detach().numpy()
    look: dict[str, Any] = {"facecolor": "none", "edgecolor": (VERMILLION, 0.6), "linewidth": 0.7}
    widths, heights, angles = _ellipses(predicted)
    panel.add_collection(EllipseCollection(widths, heights, angles, **places, **look))
    strokes = (
        (shown, BLUE, "-", 0.7, f"{len(shown)} strokes of people"),
        (predicted.mean[None], VERMILLION, "-", 1.4, f"predicted ± {BAND} std"),
        (written[:FEW], DARK, (0, (4, 2)), 0.9, f"robot: {rollouts_of(len(written))}"),
    )
    for paths, colour, line, width, label in strokes:
        x, y = paths.detach().numpy().transpose(2, 1, 0)
        drawn = panel.plot(x, y, color=colour, linestyle=line, linewidth=width)
        drawn[0].set_label(label)
    panel.set_aspect("equal", adjustable="datalim")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MultipleLocator(0.1))


def _ellipses(belief: Gaussian) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diameters and angle (degrees) of ``BAND`` standard deviations, (T,) each."""
    variances, axes = np.linalg.eigh(belief.cov.detach().numpy())
    diameters = 2 * BAND * np.sqrt(np.maximum(variances, 0.0))
    return diameters[:, 1], diameters[:, 0], np.degrees(np.arctan2(axes[:, 1, 1], axes[:, 0, 1]))
