"""Figure of the calibration of predicted success rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torch_pmil.plotting.calibration import draw_rates
from torch_pmil.plotting.style import BLUE, SKY, WIDTH, check_some, legend_above


def plot_success_calibration(
    predictions: Mapping[str, Mapping[str, Sequence[Sequence[float]]]],
) -> Figure:
    """Measured over predicted success rates, a panel for each kind of prediction.

    Args:
        predictions: by title, "trials", the predicted and measured rate of each, drawn as small
            points, and "bins", the mean predicted and measured rate of the trials in each with the
            lower and upper end of an interval.

    Raises:
        ValueError: there is no prediction.

    Example:
        >>> drawn = {"trials": [(0.9, 1.0), (0.9, 0.8)], "bins": [(0.9, 0.9, 0.8, 0.95)]}
        >>> plot_success_calibration({"before": drawn}).axes[0].get_xlabel()
        'predicted success rate (%)'
    """
    check_some("predictions", predictions)
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    panels = figure.subplots(1, len(predictions), sharey=True, squeeze=False)[0]
    for panel, (title, drawn) in zip(panels, predictions.items(), strict=True):
        draw_success_calibration(panel, drawn)
        panel.set(title=title, xlabel="predicted success rate (%)")
    panels[0].set_ylabel("measured success rate (%)")
    legend_above(figure, 2, panels[0])
    return figure


def draw_success_calibration(panel: Axes, drawn: Mapping[str, Sequence[Sequence[float]]]) -> None:
    """Draw the trials and bins of :func:`plot_success_calibration`, with a diagonal."""
    draw_rates(panel)
    trials = 100 * np.asarray(drawn["trials"])
    panel.plot(*trials.T, ".", color=SKY, markersize=4, alpha=0.5, clip_on=False, label="trials")
    predicted, measured, lower, upper = 100 * np.transpose(drawn["bins"])
    bins = panel.errorbar(
        predicted,
        measured,
        np.maximum([measured - lower, upper - measured], 0),
        color=BLUE,
        marker="o",
        markersize=5,
        linewidth=1.4,
        capsize=3,
        zorder=3,
        label="means in bins, 95 % intervals",
    )
    for artist in bins.get_children():
        artist.set_clip_on(False)
