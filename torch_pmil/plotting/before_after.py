"""Recordings before and after a step that prepares them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.control.state_space import with_unit
from torch_pmil.plotting.style import BLUE, style

Timed = tuple[Tensor, Tensor]  # times (T_n,) and values (T_n, M)


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
        names: names of the M entries.
        units: units of the M entries.
        before: times (T_n,), in s, and values (T_n, M) of each trajectory. If the last entries were
            not recorded, such as a velocity that the step derives, values (T_n, M') hold the first
            M' <= M entries.
        after: times and values of each trajectory after the step, like ``before``.
        title: title of the right column, which says what was done.
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
            _draw(panel, trajectories, row, markers)
    for row, (name, unit) in enumerate(zip(names, units, strict=True)):
        panels[row, 0].set_ylabel(with_unit(name, unit))
    figure.align_ylabels(panels[:, 0])
    return figure


def _draw(panel: Axes, trajectories: Sequence[Timed], entry: int, markers: bool) -> None:
    style(panel)
    shown = [(times, values[:, entry]) for times, values in trajectories if entry < values.shape[1]]
    marker = "." if markers else None
    for times, values in shown:
        panel.plot(times, values, color=BLUE, linewidth=1.0, alpha=0.8, marker=marker, markersize=3)
    if not shown:
        middle: dict[str, Any] = {"transform": panel.transAxes, "ha": "center", "va": "center"}
        panel.text(0.5, 0.5, "not recorded", color="0.4", **middle)
