"""Figure of a model's calibration: how sure it is, against how right it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.model.calibration import observed_coverage
from torch_pmil.plotting.style import (
    BLUE,
    DARK,
    GREY,
    SERIES,
    SKY,
    WIDTH,
    check_some,
    draw_range,
    style,
)

INTERVALS = 50  # number of intervals of the reliability diagram
# label of the axis of each quantity of a calibration, its factor there, and its value of Gaussians
QUANTITIES = {
    "coverage": ("within two predicted std (%)", 100, 95.45),
    "standardised_error": ("rms error (predicted std)", 1, 1.0),
    "nll": ("-log likelihood (nats a state)", 1, None),
}


def plot_calibration(names: Sequence[str], time_step: float, residuals: Tensor) -> Figure:
    """Calibration of a model: how many errors lie in its intervals, and their size over time.

    On the left the reliability diagram: the fraction of errors inside the central interval that
    should hold them with a given probability. Below the diagonal the model is too sure of itself,
    above it not sure enough. On the right the root mean square of the errors in predicted standard
    deviations, over the rollouts at each time: 1 where the model is as right as it says.

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
        coverage.plot(
            100 * probabilities.numpy(), observed[:, entry], label=name, markevery=10, **look
        )
        course.plot(time, sizes[:, entry], **look)
    course.set(xlabel="time (s)", ylabel="rms error (predicted std)")
    course.set_yscale("symlog", linthresh=2) if sizes.max() > 10 else course.set_ylim(bottom=0)
    for panel in (coverage, course):
        style(panel)
    figure.legend(
        *coverage.get_legend_handles_labels(), loc="outside upper center", ncols=8, frameon=False
    )
    return figure


def plot_calibration_ahead(
    ahead: Sequence[int], models: Mapping[str, Mapping[str, np.ndarray]]
) -> Figure:
    """Calibration of several models over the number of steps that they predict ahead.

    Dashed is what a model has that is as right as it says.

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
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False
    )
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
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return figure


def draw_success_calibration(panel: Axes, drawn: Mapping[str, Sequence[Sequence[float]]]) -> None:
    """Trials and bins of :func:`plot_success_calibration` in a panel, with its diagonal."""
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


def draw_rates(panel: Axes, lowest: float = 0) -> None:
    """A square panel of rates over rates in percent, from the lowest one on, with its diagonal."""
    ends = (lowest, 100)
    panel.plot(ends, ends, color=GREY, linewidth=1.0, linestyle="--", zorder=1)
    panel.set(xlim=ends, ylim=ends, aspect="equal")
    style(panel)


def _draw_diagonal(panel: Axes) -> None:
    draw_rates(panel)
    told: dict[str, Any] = {
        "transform": panel.transAxes,
        "color": DARK,
        "fontsize": "small",
        "zorder": 4,
        "bbox": {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
    }
    panel.text(0.03, 0.96, "not sure enough", va="top", **told)
    panel.text(0.97, 0.04, "too sure", ha="right", **told)
    panel.set(xlabel="probability of the interval (%)", ylabel="errors inside (%)")
    panel.set_xticks([0, 25, 50, 75, 100])
    panel.set_yticks([0, 25, 50, 75, 100])
