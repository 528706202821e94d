"""Figures of success rates over the mass of a link, and over settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from reproduction.plots.ranges import draw_range
from torch_pmil.plotting.style import (
    BLUE,
    DARK,
    GREY,
    SERIES,
    check_some,
    legend_above,
    style,
)
from torch_pmil.plotting.success import success_axis


def plot_success_over_mass(
    masses: Sequence[float],
    rates: Mapping[str, np.ndarray],
    torques: np.ndarray,
    limit: float,
    demonstrated: float,
) -> Figure:
    """Success rate over the mass of the second link, and the torque that exact tracking needs.

    Section 5.1.2 has this comparison.

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
    success_axis(upper)
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
    legend_above(figure, 2, upper, lower)
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
        success_axis(panel)
        line = panel.axvline(usual, color=GREY, linewidth=0.8, linestyle="--")
        mean = f"mean of {len(rates)} runs, and their range"
        draw_range(panel, levels, 100 * rates, BLUE, "o", mean)
        panel.set_xticks(levels, [f"{level:g}" for level in levels])
        panel.set(xlabel=label)
        panel.label_outer()
        style(panel)
    line.set_label("as in the other panels")
    legend_above(figure, 2, axes[-1])
    return figure
