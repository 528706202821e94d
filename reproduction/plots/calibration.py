"""Figures of calibration: of models over steps ahead, and of predicted success rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reproduction.plots.ranges import draw_range
from torch_pmil.plotting.calibration import draw_rates
from torch_pmil.plotting.style import (
    BLUE,
    GREY,
    SERIES,
    SKY,
    WIDTH,
    check_some,
    legend_above,
    style,
)

# label of the axis of each quantity of a calibration, its factor there, and its value of Gaussians
QUANTITIES = {
    "coverage": ("within two predicted std (%)", 100, 95.45),
    "standardised_error": ("rms error (predicted std)", 1, 1.0),
    "nll": ("-log likelihood (nats a state)", 1, None),
}


def plot_calibration_ahead(
    ahead: Sequence[int], models: Mapping[str, Mapping[str, np.ndarray]]
) -> Figure:
    """Calibration of several models over the number of steps that they predict ahead.

    The dashed line is that of a calibrated model.

    Args:
        ahead: K numbers of steps.
        models: by label, "coverage" (fraction of entries within two predicted standard deviations),
            "standardised_error" and "nll", (runs, K) each. The mean is drawn with the range over
            the runs.

    Raises:
        ValueError: there is no model, or its numbers do not fit the number of steps.

    Example:
        >>> values = dict.fromkeys(("coverage", "standardised_error", "nll"), np.ones((3, 2)))
        >>> len(plot_calibration_ahead([1, 5], {"in time": values}).axes)
        3
    """
    check_some("models", models)
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    panels = figure.subplots(1, len(QUANTITIES))
    for panel, (quantity, (label, factor, ideal)) in zip(panels, QUANTITIES.items(), strict=True):
        if ideal is not None:
            panel.axhline(ideal, color=GREY, linewidth=1.0, linestyle="--")
        for (name, values), (colour, marker) in zip(models.items(), cycle(SERIES), strict=False):
            if values[quantity].shape[1:] != (len(ahead),):
                raise ValueError(
                    f"{quantity} of {name} must be (runs, {len(ahead)}), got "
                    f"{values[quantity].shape}"
                )
            draw_range(panel, ahead, factor * values[quantity], colour, marker, name)
        panel.set(xscale="log", xlabel="steps ahead", ylabel=label)
        panel.set_xticks(ahead, [f"{steps}" for steps in ahead])
        panel.minorticks_off()
        style(panel)
    legend_above(figure, 4, panels[0])
    return figure


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
