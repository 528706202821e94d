"""Figure of demonstrations as they were recorded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from torch import Tensor

from torch_pmil.control.state_space import with_unit
from torch_pmil.plotting.style import BLUE, DARK, GREEN, GREY, ORANGE, VERMILLION, style

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, DARK)
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1)))
TOLD_APART = len(COLOURS) * len(DASHES)  # more demonstrations than this are all of one colour
TICKS = 6  # most ticks on the lower axis of a path: more labels would touch
ENDS = {"start": (0, "o"), "end": (-1, "x")}  # sample and marker of each end of a path
WIDTH, LINE = 10, 8  # characters in an inch of the legend, and those that a line in it takes


def plot_recordings(
    labels: Sequence[str],
    times: Sequence[Tensor],
    values: Sequence[Tensor],
    names: Sequence[str],
    units: Sequence[str] = (),
) -> Figure:
    """Entries of all demonstrations over the time since their start, and paths in planes.

    The path of each pair of entries x..., y... is drawn in their plane.

    Args:
        labels: labels of the N demonstrations.
        times: times of the samples of each demonstration, in s, (T_n,).
        values: observations of each demonstration, (T_n, M).
        names: names of the M entries.
        units: units of the M entries; empty if they are not known.

    Raises:
        ValueError: numbers of labels, times and values, or of names, units and entries, differ.

    Example:
        >>> import torch
        >>> time = torch.linspace(0, 1, 11)
        >>> path = torch.stack([time, time**2], 1)
        >>> figure = plot_recordings(["1"], [time], [path], ["x", "y"], ["m", "m"])
        >>> [panel.get_ylabel() for panel in figure.axes]
        ['x (m)', 'y (m)', 'y (m)']
    """
    widths = {value.shape[1] for value in values if len(value)}
    if not len(labels) == len(times) == len(values) or widths != {len(names)}:
        raise ValueError(
            f"{len(labels)} labels and {len(names)} names must be those of {len(values)} "
            f"trajectories of {', '.join(map(str, sorted(widths))) or 'nothing'}, got {len(times)} "
            "times"
        )
    if units and len(units) != len(names):
        raise ValueError(f"units must be those of the {len(names)} names, got {len(units)}")
    texts = list(names)
    if units:
        texts = list(map(with_unit, names, units))
    figure, panels, planes = _layout(texts, _pairs(names))
    looks = _looks(len(labels))
    for label, time, value, look in zip(labels, times, values, looks, strict=True):
        for column, panel in enumerate(panels):
            panel.plot(time - time[0], value[:, column], label=label, linewidth=1.1, **look)
        for (x, y), plane in zip(_pairs(names), planes, strict=True):
            _draw_path(plane, value[:, x].numpy(), value[:, y].numpy(), look)
    if len(labels) <= TOLD_APART:
        handles, told = panels[0].get_legend_handles_labels()
        rows = math.ceil(sum(len(label) + LINE for label in told) / (WIDTH * figure.get_figwidth()))
        form: dict[str, Any] = {"ncols": math.ceil(len(told) / rows), "frameon": False}
        figure.legend(handles, told, title="demonstration", loc="outside upper center", **form)
    return figure


def _pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Columns of entries x and y, x1 and y1, and so on."""
    return [
        (column, names.index(f"y{name[1:]}"))
        for column, name in enumerate(names)
        if name[:1] == "x" and f"y{name[1:]}" in names
    ]


def _looks(count: int) -> list[dict[str, Any]]:
    """Colours and dashes that can be told apart, or one thin colour for all."""
    if count > TOLD_APART:
        return count * [{"color": GREY, "alpha": 0.4}]
    return [
        {"color": COLOURS[number % len(COLOURS)], "linestyle": DASHES[number // len(COLOURS)]}
        for number in range(count)
    ]


def _layout(
    texts: Sequence[str], pairs: Sequence[tuple[int, int]]
) -> tuple[Figure, list[Axes], list[Axes]]:
    """Figure with panels over time on the left and planes on the right."""
    rows = max(min(len(texts), 2), round(len(texts) ** 0.5))
    columns = -(-len(texts) // rows)
    height = 0.9 + 2.0 * rows
    side = (height - 0.9) / len(pairs) if pairs else 0.0
    figsize = 0.6 + 3.4 * columns + 1.15 * side, height
    figure = Figure(figsize=figsize, layout=ConstrainedLayoutEngine(w_pad=0.08))
    ratios = [3.4 * columns, 1.15 * side] if pairs else None
    grid = figure.add_gridspec(1, 1 + bool(pairs), width_ratios=ratios)
    times = grid[0].subgridspec(rows, columns)
    panels = [figure.add_subplot(times[number]) for number in range(len(texts))]
    right = grid[-1].subgridspec(max(1, len(pairs)), 1)
    planes = [figure.add_subplot(right[number]) for number in range(len(pairs))]
    for number, panel in enumerate(panels):
        style(panel)
        panel.margins(x=0)
        panel.set_ylabel(texts[number])
        if number + columns < len(texts):
            panel.tick_params(labelbottom=False)
        else:
            panel.set_xlabel("time (s)")
    for plane, (x, y) in zip(planes, pairs, strict=True):
        style(plane)
        plane.set(xlabel=texts[x], ylabel=texts[y], aspect="equal", adjustable="datalim")
        plane.locator_params(axis="x", nbins=TICKS)
        keys = [
            Line2D([], [], color=DARK, marker=marker, markersize=5, linestyle="none", label=end)
            for end, (_, marker) in ENDS.items()
        ]
        plane.legend(handles=keys, loc="best", fontsize="small", frameon=False, handletextpad=0.1)
    figure.align_ylabels(panels)
    return figure, panels, planes


def _draw_path(plane: Axes, x: np.ndarray, y: np.ndarray, look: dict[str, Any]) -> None:
    plane.plot(x, y, linewidth=1.1, **look)
    for at, marker in ENDS.values():
        plane.plot(x[at], y[at], marker=marker, markersize=5, linestyle="none", color=look["color"])
