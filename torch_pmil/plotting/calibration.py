"""Figure of a model's calibration: the errors it predicts, beside those it makes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.model.calibration import observed_coverage
from torch_pmil.plotting.style import DARK, GREY, SERIES, WIDTH, legend_above, style

INTERVALS = 50  # number of intervals of the reliability diagram


def plot_calibration(names: Sequence[str], time_step: float, residuals: Tensor) -> Figure:
    """Calibration of a model: how many errors lie in its intervals, and their size over time.

    The left panel is the reliability diagram: the fraction of errors inside the central interval of
    a given probability. Below the diagonal the model is overconfident, above it underconfident. The
    right panel shows the root mean square of the errors over the rollouts at each time, in
    predicted standard deviations. A calibrated model has 1.

    Args:
        names: names of the D entries of the state.
        time_step: seconds between two samples; the first one shown is t = 1.
        residuals: errors in predicted standard deviations at t = 1..T of N rollouts, (N, T, D), see
            :func:`~torch_pmil.model.calibration.standardised_residuals`.

    Raises:
        ValueError: the residuals do not have that many entries.

    Example:
        >>> residuals = torch.randn(5, 25, 2, generator=torch.Generator().manual_seed(0))
        >>> figure = plot_calibration(("q", "dq"), 0.1, residuals)
        >>> [panel.get_ylabel() for panel in figure.axes]
        ['errors inside (%)', 'rms error (predicted std)']
    """
    if residuals.ndim != 3 or residuals.shape[-1] != len(names) or not residuals.numel():
        raise ValueError(
            f"residuals must be (N, T, {len(names)}) for {', '.join(names)}, got "
            f"{tuple(residuals.shape)}"
        )
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    coverage, course = figure.subplots(1, 2, width_ratios=(1, 1.3))
    _draw_diagonal(coverage)
    course.axhline(1, color=GREY, linewidth=1.0, linestyle="--")
    probabilities = torch.linspace(0, 1, INTERVALS + 1, dtype=residuals.dtype)
    observed = 100 * observed_coverage(residuals, probabilities).numpy()
    sizes = residuals.square().mean(0).sqrt().numpy()
    time = time_step * np.arange(1, len(sizes) + 1)
    for entry, (name, (colour, marker)) in enumerate(zip(names, cycle(SERIES), strict=False)):
        look = {"color": colour, "marker": marker, "markersize": 4, "linewidth": 1.4}
        expected = 100 * probabilities.numpy()
        coverage.plot(expected, observed[:, entry], label=name, markevery=10, **look)
        course.plot(time, sizes[:, entry], **look)
    course.set(xlabel="time (s)", ylabel="rms error (predicted std)")
    course.set_yscale("symlog", linthresh=2) if sizes.max() > 10 else course.set_ylim(bottom=0)
    for panel in (coverage, course):
        style(panel)
    legend_above(figure, 8, coverage)
    return figure


def draw_rates(panel: Axes, lowest: float = 0) -> None:
    """Set up a square panel of rates over rates in percent, from the lowest, with a diagonal."""
    ends = (lowest, 100)
    panel.plot(ends, ends, color=GREY, linewidth=1.0, linestyle="--", zorder=1)
    panel.set(xlim=ends, ylim=ends, aspect="equal")
    style(panel)


def _draw_diagonal(panel: Axes) -> None:
    draw_rates(panel)
    look: dict[str, Any] = {
        "transform": panel.transAxes,
        "color": DARK,
        "fontsize": "small",
        "zorder": 4,
        "bbox": {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
    }
    panel.text(0.03, 0.96, "not sure enough", va="top", **look)
    panel.text(0.97, 0.04, "too sure", ha="right", **look)
    panel.set(xlabel="probability of the interval (%)", ylabel="errors inside (%)")
    panel.set(xticks=[0, 25, 50, 75, 100], yticks=[0, 25, 50, 75, 100])
