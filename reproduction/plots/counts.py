"""Figure of counts by kind, as stacked bars."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torch_pmil.plotting.style import COLOURS, GREY, HATCHES, WIDTH, check_some, style


def plot_counts(table: Mapping[str, Mapping[str, int]], what: str) -> Figure:
    """A bar for each row, from above, stacked from its kinds.

    Kinds that were never counted are left out.

    Args:
        table: by row, the count of each kind; all rows have the same kinds.
        what: is counted.

    Raises:
        ValueError: there is no row, or rows have different kinds.

    Example:
        >>> figure = plot_counts({"Pendulum": {"learned": 28, "failed": 2}}, "runs")
        >>> figure.axes[0].get_xlabel()
        'number of runs'
    """
    check_some("table", table)
    kinds = {tuple(counts) for counts in table.values()}
    if len(kinds) > 1:
        raise ValueError(f"all rows must have the same kinds, got {sorted(kinds)}")
    figure = Figure(figsize=(WIDTH, 1.2 + 0.25 * len(table)), layout="constrained")
    panel = figure.subplots()
    _draw_bars(panel, table)
    panel.set(xlabel=f"number of {what}")
    style(panel)
    panel.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize="small")
    return figure


def _draw_bars(panel: Axes, table: Mapping[str, Mapping[str, int]]) -> None:
    kinds, counts = list(next(iter(table.values()))), [list(row.values()) for row in table.values()]
    widths = np.array(counts, dtype=int)
    begins = widths.cumsum(1) - widths
    looks = zip(cycle((*COLOURS, GREY)), cycle(HATCHES), strict=False)
    for kind, width, begin, (colour, hatch) in zip(kinds, widths.T, begins.T, looks, strict=False):
        if width.any():
            look: dict[str, Any] = {"facecolor": colour, "hatch": hatch, "label": kind}
            panel.barh(list(table), width, left=begin, edgecolor="white", linewidth=0.6, **look)
    panel.set_xlim(0, 1.02 * widths.sum(1).max())
    panel.invert_yaxis()
