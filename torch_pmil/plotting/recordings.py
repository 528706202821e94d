"""Figures of recorded demonstrations, and of a step that prepares them."""

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
from torch_pmil.plotting.style import (
    BLUE,
    DARK,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    label_over_time,
    labelled,
    style,
)

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, DARK)
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1)))
DISTINCT = len(COLOURS) * len(DASHES)  # more demonstrations than this all have one colour
TICKS = 6  # most ticks on the lower axis of a path: more labels would touch
ENDS = {"start": (0, "o"), "end": (-1, "x")}  # sample and marker of each end of a path
WIDTH, LINE = 10, 8  # characters in an inch of the legend, and those that a line in it takes

Timed = tuple[Tensor, Tensor]  # times (T_n,) and values (T_n, M)


def plot_recordings(
    labels: Sequence[str],
    times: Sequence[Tensor],
    values: Sequence[Tensor],
    names: Sequence[str],
    units: Sequence[str] = (),
) -> Figure:
    """Entries of all demonstrations over the time since their start, and paths in planes.

    There is a plane for each pair of entries x..., y....

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
    texts = list(map(with_unit, names, units)) if units else names
    pairs = _pairs(names)
    figure, panels, planes = _layout(texts, pairs)
    looks = _looks(len(labels))
    for label, time, value, look in zip(labels, times, values, looks, strict=True):
        for column, panel in enumerate(panels):
            panel.plot(time - time[0], value[:, column], label=label, linewidth=1.1, **look)
        for (x, y), plane in zip(pairs, planes, strict=True):
            _draw_path(plane, value[:, x].numpy(), value[:, y].numpy(), look)
    if len(labels) <= DISTINCT:
        rows = sum(len(label) + LINE for label in labels) / (WIDTH * figure.get_figwidth())
        columns = math.ceil(len(labels) / math.ceil(rows))
        form: dict[str, Any] = {"handles": labelled(panels[0]), "ncols": columns, "frameon": False}
        figure.legend(title="demonstration", loc="outside upper center", **form)
    return figure


def _pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Columns of entries x and y, x1 and y1, and so on."""
    return [
        (column, names.index(f"y{name[1:]}"))
        for column, name in enumerate(names)
        if name[:1] == "x" and f"y{name[1:]}" in names
    ]


def _looks(count: int) -> list[dict[str, Any]]:
    """Different colours and dashes, or one faint colour for all."""
    if count > DISTINCT:
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
    label_over_time(figure, panels, texts, columns)
    for plane, (x, y) in zip(planes, pairs, strict=True):
        style(plane)
        plane.set(xlabel=texts[x], ylabel=texts[y], aspect="equal", adjustable="datalim")
        plane.locator_params(axis="x", nbins=TICKS)
        keys = [
            Line2D([], [], color=DARK, marker=marker, markersize=5, linestyle="none", label=end)
            for end, (_, marker) in ENDS.items()
        ]
        plane.legend(handles=keys, loc="best", fontsize="small", frameon=False, handletextpad=0.1)
    return figure, panels, planes


def _draw_path(plane: Axes, x: np.ndarray, y: np.ndarray, look: dict[str, Any]) -> None:
    plane.plot(x, y, linewidth=1.1, **look)
    for at, marker in ENDS.values():
        plane.plot(x[at], y[at], marker=marker, markersize=5, linestyle="none", color=look["color"])


def plot_before_after(
    names: Sequence[str],
    units: Sequence[str],
    before: Sequence[Timed],
    after: Sequence[Timed],
    title: str = "after",
    markers: bool = False,
) -> Figure:
    """All trajectories over time, before a step on the left and after it on the right.

    There is one row for each entry.

    Args:
        names, units: those of the M entries.
        before: times (T_n,), in s, and values (T_n, M) of each trajectory. If the last entries were
            not recorded, such as a velocity that the step derives, values (T_n, M') hold the first
            M' <= M entries.
        after: times and values of each trajectory after the step, like ``before``.
        title: title of the right column.
        markers: whether each sample is marked.

    Raises:
        ValueError: there is no trajectory, or one has more entries than there are names, or
            different numbers of values and times.

    Example:
        >>> import torch
        >>> times = torch.arange(5)
        >>> one = [(times, torch.zeros(5, 1))]
        >>> [panel.get_ylabel() for panel in plot_before_after(("x",), ("m",), one, one).axes]
        ['x (m)', '']
    """
    for number, (times, values) in enumerate([*before, *after]):
        paired = values.ndim == 2 and len(times) == len(values)
        if not paired or values.shape[1] > len(names) or len(names) != len(units):
            raise ValueError(
                f"trajectory {number} must have times (T,) and values (T, M) with M of at most "
                f"{len(names)} names with {len(units)} units, got {tuple(times.shape)} and "
                f"{tuple(values.shape)}"
            )
    if not (before and after):
        raise ValueError(
            f"there must be a trajectory before and one after, got {len(before)} and {len(after)}"
        )
    figure = Figure(figsize=(8.0, 0.8 + 1.8 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), 2, sharex=True, sharey="row", squeeze=False)
    for column, (heading, trajectories) in enumerate((("before", before), (title, after))):
        panels[0, column].set_title(heading)
        panels[-1, column].set_xlabel("time (s)")
        for row, panel in enumerate(panels[:, column]):
            _draw_entry(panel, trajectories, row, markers)
    for row, (name, unit) in enumerate(zip(names, units, strict=True)):
        panels[row, 0].set_ylabel(with_unit(name, unit))
    figure.align_ylabels(panels[:, 0])
    return figure


def _draw_entry(panel: Axes, trajectories: Sequence[Timed], entry: int, markers: bool) -> None:
    style(panel)
    shown = [(times, values[:, entry]) for times, values in trajectories if entry < values.shape[1]]
    marker = "." if markers else None
    for times, values in shown:
        panel.plot(times, values, color=BLUE, linewidth=1.0, alpha=0.8, marker=marker, markersize=3)
    if not shown:
        middle: dict[str, Any] = {"transform": panel.transAxes, "ha": "center", "va": "center"}
        panel.text(0.5, 0.5, "not recorded", color="0.4", **middle)
