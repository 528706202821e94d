"""Figures of success rates: over experience, and beside the loss."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from torch_pmil.plotting.style import (
    BLUE,
    DARK,
    GREY,
    SERIES,
    VERMILLION,
    WIDTH,
    check_some,
    legend_above,
    style,
)


def plot_learning_curve(
    experience_s: Sequence[float],
    success_rate: Sequence[float],
    loss: Sequence[float],
    label: str = "predicted KL (nats)",
    saved: tuple[float, float, float] | None = None,
    of_one_rollout: bool = False,
) -> Figure:
    """Success rate (Figure 7) and loss after each trial, over the robot's experience.

    Args:
        experience_s: seconds of motion the robot had learned from, (N,).
        success_rate: fractions from 0 to 1, (N,); drawn in percent, with the paper's 95 % as a
            dotted line.
        loss: loss of each trial, such as the predicted KL over the trajectory, (N,), on a
            logarithmic axis; a cross at the top stands for one that is not finite or not positive.
        label: name of the loss, with its unit.
        saved: experience (s), success rate and loss of the policy that was saved at the end, drawn
            as a star; None draws no star.
        of_one_rollout: whether each rate comes from a trial's own rollout alone, and so is 0 or 1.

    Raises:
        ValueError: the lengths differ, or a success rate is outside 0 to 1.

    Example:
        >>> figure = plot_learning_curve([2.5, 5.0], [0.0, 0.9], [4e3, 20.0])
        >>> figure.axes[1].get_xlabel(), figure.axes[1].get_ylabel()
        ('experience (s)', 'predicted KL (nats)')
    """
    if not len(experience_s) == len(success_rate) == len(loss):
        raise ValueError(
            "experience_s, success_rate and loss must be equally long, got "
            f"{len(experience_s)}, {len(success_rate)}, {len(loss)}"
        )
    percent = 100 * np.asarray(success_rate, dtype=float)
    if not ((percent >= 0) & (percent <= 100)).all():
        raise ValueError(f"success_rate must be between 0 and 1, got {list(success_rate)}")
    check_some("experience_s", experience_s)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    (_outcome_axis if of_one_rollout else success_axis)(upper)
    points: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 4}
    line = "none" if of_one_rollout else "solid"
    upper.plot(experience_s, percent, linestyle=line, clip_on=False, zorder=3, **points)
    _draw_losses(lower, np.asarray(experience_s), np.asarray(loss, dtype=float))
    if saved is not None:
        _draw_saved(upper, lower, *saved)
    lower.set(yscale="log", xlabel="experience (s)", ylabel=label)
    lower.set_xlim(left=0)
    _plain_numbers(lower)
    for panel in (upper, lower):
        style(panel)
    legend_above(figure, 2, upper, lower)
    return figure


def _draw_losses(panel: Axes, experience_s: np.ndarray, losses: np.ndarray) -> None:
    """Draw losses, and a cross at the top for each one that has no logarithm."""
    there = np.isfinite(losses) & (losses > 0)
    squares: dict[str, Any] = {"color": VERMILLION, "marker": "s", "markersize": 4}
    panel.plot(experience_s, np.where(there, losses, np.nan), zorder=3, **squares)
    if not there.all():
        missing = experience_s[~there]
        top: dict[str, Any] = {"transform": panel.get_xaxis_transform(), "color": GREY}
        panel.plot(missing, np.full(len(missing), 0.95), "x", label="no value", **top)


def _draw_saved(upper: Axes, lower: Axes, experience_s: float, rate: float, loss: float) -> None:
    star: dict[str, Any] = {"color": DARK, "marker": "*", "markersize": 10, "linestyle": ""}
    label = "the saved policy at the end"
    upper.plot(experience_s, 100 * rate, label=label, clip_on=False, zorder=4, **star)
    lower.plot(experience_s, loss if loss > 0 else np.nan, zorder=4, **star)


def _plain_numbers(panel: Axes) -> None:
    """Label a logarithmic axis with plain numbers, also between decades if it has less than one."""
    low, high = panel.get_ylim()
    plain = StrMethodFormatter("{x:g}")
    panel.yaxis.set_major_formatter(plain)
    panel.yaxis.set_minor_formatter(plain if high < 10 * low else NullFormatter())


def plot_success_over_experience(
    experience_s: np.ndarray, rates: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> Figure:
    """Mean success rate over runs with its 95 % interval, and each run as a thin line (Figure 7).

    Args:
        experience_s: seconds of motion the robot had learned from, (K,).
        rates: fractions from 0 to 1, (runs, K); drawn in percent, with the paper's 95 % as a dotted
            line.
        lower, upper: ends of the interval of the mean, fractions, (K,) each.

    Raises:
        ValueError: the shapes do not fit each other.

    Example:
        >>> seconds, rates = np.array([2.5, 5.0]), np.array([[0.0, 1.0]])
        >>> figure = plot_success_over_experience(seconds, rates, np.zeros(2), np.ones(2))
        >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
        ('experience (s)', 'success rate (%)')
    """
    if not experience_s.shape == lower.shape == upper.shape == rates.shape[1:]:
        raise ValueError(
            "experience_s, lower and upper must be (K,) for rates (runs, K), got "
            f"{experience_s.shape}, {lower.shape}, {upper.shape} for {rates.shape}"
        )
    check_some("rates", rates)
    figure, panel = _one_panel()
    thin: dict[str, Any] = {"color": GREY, "linewidth": 0.7, "alpha": 0.5, "clip_on": False}
    runs = panel.plot(experience_s, 100 * rates.T, **thin)
    runs[0].set_label("single runs")
    band: dict[str, Any] = {"facecolor": (BLUE, 0.2), "edgecolor": (BLUE, 0.6), "linewidth": 0.8}
    band["label"] = "95 % interval of the mean"
    panel.fill_between(experience_s, 100 * lower, 100 * upper, **band)
    _draw_mean(panel, experience_s, rates.mean(0), BLUE, "o", f"mean of {len(rates)} runs")
    panel.set_xlim(left=0)
    legend_above(figure, 3, panel)
    return figure


def plot_success_of_methods(curves: Mapping[str, Sequence[np.ndarray]]) -> Figure:
    """Mean success rate of several methods over the robot's experience (Figure 7).

    Each has its 95 % interval.

    Args:
        curves: by the name of the method, seconds of motion that the robot had learned from, the
            mean over runs, and both ends of its interval, (K,) each. Rates are fractions from 0 to
            1; drawn in percent, with the paper's 95 % as a dotted line.

    Raises:
        ValueError: the lengths of a method's curves differ.

    Example:
        >>> mean = np.array([0.0, 1.0])
        >>> figure = plot_success_of_methods({"a": (np.array([2.5, 5.0]), mean, mean, mean)})
        >>> [text.get_text() for text in figure.legends[0].get_texts()]
        ['a']
    """
    check_some("curves", curves)
    figure, panel = _one_panel()
    for (name, curve), (colour, marker) in zip(curves.items(), cycle(SERIES), strict=False):
        lengths = [len(values) for values in curve]
        if len(lengths) != 4 or len(set(lengths)) > 1:
            raise ValueError(
                f"experience, mean and interval of {name} must be equally long, got {lengths}"
            )
        experience_s, mean, lower, upper = curve
        band: dict[str, Any] = {"facecolor": (colour, 0.15), "edgecolor": (colour, 0.5)}
        panel.fill_between(experience_s, 100 * lower, 100 * upper, linewidth=0.6, **band)
        _draw_mean(panel, experience_s, mean, colour, marker, name)
    panel.set_xlim(left=0)
    legend_above(figure, len(curves) if len(curves) < 4 else 2, panel)
    return figure


def _one_panel() -> tuple[Figure, Axes]:
    """A figure of success rates over the experience."""
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    panel = figure.subplots()
    success_axis(panel)
    panel.set(xlabel="experience (s)")
    style(panel)
    return figure, panel


def _draw_mean(
    panel: Axes, experience_s: np.ndarray, mean: np.ndarray, colour: str, marker: str, label: str
) -> None:
    look: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 4, "label": label}
    panel.plot(experience_s, 100 * mean, clip_on=False, zorder=3, **look)


def _outcome_axis(panel: Axes) -> None:
    """Set up an axis of rollouts, each of which failed or succeeded."""
    panel.set(ylim=(-25, 125), ylabel="own rollout")
    panel.set_yticks([0, 100], ["failed", "succeeded"])


def success_axis(panel: Axes) -> None:
    """Set up an axis of success rates, with the paper's 95 %."""
    panel.axhline(95, color=GREY, linewidth=0.8, linestyle=":")
    beside: dict[str, Any] = {"transform": panel.get_yaxis_transform(), "va": "center"}
    panel.text(1.01, 95, "95 %", fontsize=8, color=GREY, **beside)
    panel.set(ylim=(0, 100), ylabel="success rate (%)")
    panel.set_yticks([0, 25, 50, 75, 100])
