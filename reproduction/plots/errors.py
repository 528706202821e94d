"""Figure of the errors of models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from reproduction.plots.ranges import draw_range
from torch_pmil.plotting.style import (
    BLUE,
    GREEN,
    VERMILLION,
    check_some,
    legend_above,
    style,
)


def plot_errors_over_data(
    seconds: Sequence[float], panels: Mapping[str, Mapping[str, np.ndarray]]
) -> Figure:
    """Errors of several models over the experience in their fit, mean and range over runs.

    Args:
        seconds: seconds of experience, (K,).
        panels: the errors of each model, (runs, K), by a label of the error with its unit.

    Raises:
        ValueError: the errors do not fit the number of seconds.

    Example:
        >>> figure = plot_errors_over_data([6.0, 12.0], {"error (rad)": {"a": np.ones((3, 2))}})
        >>> figure.axes[0].get_ylabel()
        'error (rad)'
    """
    check_some("panels", panels)
    figure = Figure(figsize=(0.8 + 3.2 * len(panels), 3.0), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for panel, (label, models) in zip(axes, panels.items(), strict=True):
        looks = cycle(((VERMILLION, "s"), (BLUE, "o"), (GREEN, "^")))
        for (name, errors), (colour, marker) in zip(models.items(), looks, strict=False):
            if errors.shape[1:] != (len(seconds),):
                raise ValueError(
                    f"errors of {name} must be (runs, {len(seconds)}), got {errors.shape}"
                )
            draw_range(panel, seconds, errors, colour, marker, name)
        panel.set(xlabel="experience (s)", ylabel=label, ylim=(0, None))
        panel.set_xticks(seconds, [f"{second:g}" for second in seconds])
        style(panel)
    legend_above(figure, len(models), axes[0])
    return figure
