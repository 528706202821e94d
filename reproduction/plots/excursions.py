"""Figure of how far the rollouts of learning runs went beyond the limits of their motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from torch_pmil.plotting.style import GREY, SERIES, WIDTH, check_some, style

TICKS = (0.25, 0.5, 1, 2, 4, 8)  # limits
LOOK: dict[str, Any] = {"linestyle": "none", "markersize": 4.5}


def plot_excursions(
    runs: Mapping[str, Sequence[tuple[np.ndarray, np.ndarray]]], ylabel: str
) -> Figure:
    """How far each rollout of learning runs went, over the experience.

    Filled markers went beyond a limit, hollow ones stayed within.

    Args:
        runs: for each panel, by its title, the runs: seconds of experience at the end of each
            rollout, and the furthest that it went, 1 at a limit, (R,) each.
        ylabel: what is drawn.

    Raises:
        ValueError: there is no panel.

    Example:
        >>> figure = plot_excursions({"without limits": [([2.5, 5.0], [3.0, 0.5])]}, "speed")
        >>> figure.axes[0].get_title()
        'without limits'
    """
    check_some("runs", runs)
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    panels = figure.subplots(1, len(runs), sharex=True, sharey=True, squeeze=False)[0]
    for panel, (title, drawn) in zip(panels, runs.items(), strict=True):
        panel.axhline(1, color=GREY, linewidth=1.0, linestyle="--")
        for (ends, furthest), (colour, marker) in zip(drawn, cycle(SERIES), strict=False):
            outside = np.asarray(furthest) > 1
            panel.plot(ends, furthest, color=colour, linewidth=0.8, alpha=0.6)
            for chosen, face in ((outside, colour), (~outside, "white")):
                points = np.asarray(ends)[chosen], np.asarray(furthest)[chosen]
                panel.plot(*points, **LOOK, marker=marker, color=colour, markerfacecolor=face)
        panel.set(title=title, xlabel="experience (s)", yscale="log")
        panel.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
        panel.minorticks_off()
        style(panel)
    panels[0].set_ylabel(ylabel)
    faces = {"left the limits": GREY, "stayed within": "white"}
    handles = [
        Line2D([], [], **LOOK, marker="o", color=GREY, markerfacecolor=face, label=label)
        for label, face in faces.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)
    return figure
