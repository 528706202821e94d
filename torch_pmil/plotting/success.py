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
    draw_range,
    labelled,
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
        saved: experience (s), success rate and loss of the policy that was saved in the end, drawn
            as a star; None for none.
        of_one_rollout: whether each rate is of the own rollout of a trial alone: 0 or 1.

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
    losses = np.asarray(loss, dtype=float)
    check_some("experience_s", experience_s)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    (_outcome_axis if of_one_rollout else _success_axis)(upper)
    points: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 4}
    line = "none" if of_one_rollout else "solid"
    upper.plot(experience_s, percent, linestyle=line, clip_on=False, zorder=3, **points)
    there = np.isfinite(losses) & (losses > 0)
    lower.plot(
        experience_s,
        np.where(there, losses, np.nan),
        color=VERMILLION,
        marker="s",
        markersize=4,
        zorder=3,
    )
    if not there.all():
        _draw_missing(lower, np.asarray(experience_s)[~there])
    if saved is not None:
        _draw_saved(upper, lower, *saved)
    lower.set(yscale="log", xlabel="experience (s)", ylabel=label)
    lower.set_xlim(left=0)
    _plain_numbers(lower)
    for panel in (upper, lower):
        style(panel)
    if handles := labelled(upper, lower):
        figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)
    return figure


def _draw_missing(panel: Axes, experience_s: np.ndarray) -> None:
    """Draw a cross at the top where there is no value."""
    panel.plot(
        experience_s,
        np.full(len(experience_s), 0.95),
        "x",
        transform=panel.get_xaxis_transform(),
        color=GREY,
        label="no value",
    )


def _draw_saved(upper: Axes, lower: Axes, experience_s: float, rate: float, loss: float) -> None:
    star: dict[str, Any] = {"color": DARK, "marker": "*", "markersize": 10, "linestyle": ""}
    upper.plot(
        experience_s,
        100 * rate,
        label="the saved policy at the end",
        clip_on=False,
        zorder=4,
        **star,
    )
    lower.plot(experience_s, loss if loss > 0 else np.nan, zorder=4, **star)


def _plain_numbers(panel: Axes) -> None:
    """Label a logarithmic axis with plain numbers.

    The numbers between its decades are labelled too where it spans less than one decade.
    """
    low, high = panel.get_ylim()
    panel.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panel.yaxis.set_minor_formatter(
        StrMethodFormatter("{x:g}") if high < 10 * low else NullFormatter()
    )


def plot_success_over_experience(
    experience_s: np.ndarray, rates: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> Figure:
    """Mean success rate over runs with its 95 % interval, and each run as a thin line (Figure 7).

    Args:
        experience_s: seconds of motion the robot had learned from, (K,).
        rates: fractions from 0 to 1, (runs, K); drawn in percent, with the paper's 95 % as a dotted
            line.
        lower: lower end of the interval of the mean, a fraction, (K,).
        upper: upper end of the interval of the mean, a fraction, (K,).

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
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    panel = figure.subplots()
    _success_axis(panel)
    runs = panel.plot(
        experience_s, 100 * rates.T, color=GREY, linewidth=0.7, alpha=0.5, clip_on=False
    )
    runs[0].set_label("single runs")
    band: dict[str, Any] = {"facecolor": (BLUE, 0.2), "edgecolor": (BLUE, 0.6), "linewidth": 0.8}
    panel.fill_between(
        experience_s, 100 * lower, 100 * upper, label="95 % interval of the mean", **band
    )
    mean = 100 * rates.mean(0)
    panel.plot(
        experience_s,
        mean,
        color=BLUE,
        marker="o",
        markersize=4,
        clip_on=False,
        zorder=3,
        label=f"mean of {len(rates)} runs",
    )
    panel.set(xlabel="experience (s)")
    panel.set_xlim(left=0)
    style(panel)
    figure.legend(
        *panel.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False
    )
    return figure


def plot_success_of_methods(curves: Mapping[str, Sequence[np.ndarray]]) -> Figure:
    """Mean success rate of several methods over the robot's experience (Figure 7).

    Each has its 95 % interval.

    Args:
        curves: seconds of motion that the robot had learned from, (K,), the mean over runs and both
            ends of its interval, fractions from 0 to 1, (K,) each, by the name of the method; drawn
            in percent, with the paper's 95 % as a dotted line.

    Raises:
        ValueError: the lengths of a method's curves differ.

    Example:
        >>> mean = np.array([0.0, 1.0])
        >>> figure = plot_success_of_methods({"a": (np.array([2.5, 5.0]), mean, mean, mean)})
        >>> [text.get_text() for text in figure.legends[0].get_texts()]
        ['a']
    """
    check_some("curves", curves)
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    panel = figure.subplots()
    _success_axis(panel)
    for (name, curve), (colour, marker) in zip(curves.items(), cycle(SERIES), strict=False):
        lengths = [len(values) for values in curve]
        if len(lengths) != 4 or len(set(lengths)) > 1:
            raise ValueError(
                f"experience, mean and interval of {name} must be equally long, got {lengths}"
            )
        experience_s, mean, lower, upper = curve
        panel.fill_between(
            experience_s,
            100 * lower,
            100 * upper,
            facecolor=(colour, 0.15),
            edgecolor=(colour, 0.5),
            linewidth=0.6,
        )
        panel.plot(
            experience_s,
            100 * mean,
            color=colour,
            marker=marker,
            markersize=4,
            clip_on=False,
            zorder=3,
            label=name,
        )
    panel.set(xlabel="experience (s)")
    panel.set_xlim(left=0)
    style(panel)
    columns = len(curves) if len(curves) < 4 else 2
    figure.legend(loc="outside upper center", ncols=columns, frameon=False)
    return figure


def plot_success_over_mass(
    masses: Sequence[float],
    rates: Mapping[str, np.ndarray],
    torques: np.ndarray,
    limit: float,
    demonstrated: float,
) -> Figure:
    """Success rate of methods over the mass of the second link, and tracking's peak torque.

    The torque is that of exact tracking (Section 5.1.2).

    Args:
        masses: masses of the second link, kg, (K,).
        rates: success rates of each method, fractions from 0 to 1, (runs, K); their mean is drawn
            in percent with the range over the runs.
        torques: largest absolute torque that each demonstration needs, N·m, (N, K).
        limit: torque limit of the motors, N·m.
        demonstrated: mass of the demonstrator's second link, kg.

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> masses, rates, torques = [0.3, 0.5], {"a": np.ones((1, 2))}, np.ones((5, 2))
        >>> figure = plot_success_over_mass(masses, rates, torques, limit=3.5, demonstrated=0.5)
        >>> [panel.get_ylabel() for panel in figure.axes]
        ['success rate (%)', 'peak torque (N·m)']
    """
    if any(values.shape[1:] != (len(masses),) for values in (*rates.values(), torques)):
        shapes = {name: values.shape for name, values in {**rates, "torques": torques}.items()}
        raise ValueError(
            f"rates and torques must be (runs, {len(masses)}) for {len(masses)} masses, got "
            f"{shapes}"
        )
    check_some("masses", masses)
    check_some("rates", rates)
    figure = Figure(figsize=(6.0, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    _success_axis(upper)
    methods = zip(rates.items(), cycle(SERIES), strict=False)
    for index, ((name, values), (colour, marker)) in enumerate(methods):
        size = len(rates) - index  # the lower ones are larger, to be seen where all agree
        draw_range(upper, masses, 100 * values, colour, marker, name, size)
    draw_range(lower, masses, torques, GREY, "o", "exact tracking")
    lower.axhline(limit, color=DARK, linewidth=0.8, linestyle="--", label="limit of the motors")
    lower.set(xlabel="mass of the second link (kg)", ylabel="peak torque (N·m)", ylim=(0, None))
    for panel in (upper, lower):
        line = panel.axvline(demonstrated, color=GREY, linewidth=0.8, linestyle=":")
        style(panel)
    line.set_label("mass of the demonstrator")
    figure.legend(loc="outside upper center", ncols=2, frameon=False)
    return figure


def plot_success_over_settings(
    panels: Mapping[str, tuple[Sequence[float], np.ndarray]], plain: Sequence[float]
) -> Figure:
    """Success rate over one setting in each panel, with all other settings unchanged.

    Args:
        panels: K levels of the setting, and the success rates, fractions from 0 to 1, (runs, K), by
            the setting's name with its unit. The mean is drawn in percent with the range over the
            runs.
        plain: for each panel, the level of its setting in the other panels.

    Raises:
        ValueError: the rates do not fit the number of levels.

    Example:
        >>> panels = {"noise (rad)": ([0.0, 0.1], np.ones((3, 2)))}
        >>> figure = plot_success_over_settings(panels, plain=[0.0])
        >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
        ('noise (rad)', 'success rate (%)')
    """
    check_some("panels", panels)
    figure = Figure(figsize=(0.6 + 2.8 * len(panels), 3.2), layout="constrained")
    if len(plain) != len(panels):
        raise ValueError(f"plain must hold {len(panels)} levels, one a panel, got {len(plain)}")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for panel, (label, (levels, rates)), usual in zip(axes, panels.items(), plain, strict=True):
        if rates.shape[1:] != (len(levels),):
            raise ValueError(
                f"rates over {label} must be (runs, {len(levels)}) for {len(levels)} levels, got "
                f"{rates.shape}"
            )
        _success_axis(panel)
        line = panel.axvline(usual, color=GREY, linewidth=0.8, linestyle="--")
        mean = f"mean of {len(rates)} runs, and their range"
        draw_range(panel, levels, 100 * rates, BLUE, "o", mean)
        panel.set_xticks(levels, [f"{level:g}" for level in levels])
        panel.set(xlabel=label)
        panel.label_outer()
        style(panel)
    line.set_label("as in the other panels")
    figure.legend(
        *axes[-1].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False
    )
    return figure


def _outcome_axis(panel: Axes) -> None:
    """Set up an axis of rollouts, each of which failed or succeeded."""
    panel.set(ylim=(-25, 125), ylabel="own rollout")
    panel.set_yticks([0, 100], ["failed", "succeeded"])


def _success_axis(panel: Axes) -> None:
    """Set up an axis of success rates, with the paper's 95 %."""
    panel.axhline(95, color=GREY, linewidth=0.8, linestyle=":")
    panel.text(
        1.01, 95, "95 %", transform=panel.get_yaxis_transform(), fontsize=8, color=GREY, va="center"
    )
    panel.set(ylim=(0, 100), ylabel="success rate (%)")
    panel.set_yticks([0, 25, 50, 75, 100])
