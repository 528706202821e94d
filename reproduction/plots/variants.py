"""Figure of a method and its variants side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from torch_pmil.plotting.style import BLUE, DARK, VERMILLION, WIDTH, check_some, style

SPREAD = 0.5  # height over which the runs of a variant are spread, in rows


def plot_variants(labels: Sequence[str], rates: np.ndarray, first_success_s: np.ndarray) -> Figure:
    """Success rate of a method and its variants, and the experience that each needed.

    There is a row for each with a point for each run: the method on top, below it the variants, the
    best first.

    Args:
        labels: labels of the method and its variants, V in all, the method's first.
        rates: fractions from 0 to 1, (V, runs); drawn in percent, with their mean as a bar.
        first_success_s: seconds of experience before the first success, (V, runs); infinite where
            there was none, drawn as "never".

    Raises:
        ValueError: the shapes do not fit each other.

    Example:
        >>> rates, seconds = np.array([[0.9], [0.0], [1.0]]), np.array([[7.0], [np.inf], [5.0]])
        >>> figure = plot_variants(["ours", "a", "b"], rates, seconds)
        >>> [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
        ['ours', 'b', 'a']
    """
    if rates.shape[:1] != (len(labels),) or first_success_s.shape != rates.shape:
        raise ValueError(
            f"rates and first_success_s must be ({len(labels)}, runs) for {len(labels)} labels, "
            f"got {rates.shape}, {first_success_s.shape}"
        )
    check_some("labels", labels)
    best_first = np.lexsort((first_success_s[1:].mean(1), -rates[1:].mean(1)))
    order = [0, *(1 + best_first)]
    rates, seconds, rows = 100 * rates[order], first_success_s[order], np.arange(len(labels))
    figsize = WIDTH, 1.0 + 0.36 * len(labels)
    figure = Figure(figsize=figsize, layout=ConstrainedLayoutEngine(wspace=0.05))
    left, right = figure.subplots(1, 2, sharey=True)
    left.barh(rows, rates.mean(1), height=0.72, color=BLUE, alpha=0.25, label="mean")
    _draw_runs(left, rates, "o", BLUE, "a run")
    left.set(
        xlabel="success rate (%)",
        xlim=(0, 100),
        yticks=rows,
        yticklabels=[labels[index] for index in order],
    )
    succeeded = np.isfinite(seconds)
    longest = max(seconds[succeeded], default=1.0)
    _draw_runs(right, np.where(succeeded, seconds, np.nan), "o", BLUE, None)
    right.set(xlabel="experience before the first success (s)", xlim=(0, 1.05 * longest))
    if not succeeded.all():
        _draw_never(right, succeeded, longest)
    left.invert_yaxis()
    for panel in (left, right):
        style(panel)
        panel.grid(visible=False, axis="y")
        panel.tick_params(axis="y", length=0)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return figure


def _draw_never(panel: Axes, succeeded: np.ndarray, longest: float) -> None:
    """Draw crosses beyond the end of the axis for the runs (V, runs) that did not succeed."""
    never = 1.15 * longest
    _draw_runs(panel, np.where(succeeded, np.nan, never), "x", VERMILLION, "a run without success")
    panel.axvline(1.07 * longest, color=DARK, linewidth=0.6, linestyle=":")
    ticks = MaxNLocator(4, steps=[1, 5, 10]).tick_values(0, longest)
    seconds = [tick for tick in ticks if tick <= longest]
    panel.set(
        xlim=(0, 1.22 * longest),
        xticks=[*seconds, never],
        xticklabels=[*(f"{tick:g}" for tick in seconds), "never"],
    )


def _draw_runs(
    panel: Axes, values: np.ndarray, marker: str, colour: str, label: str | None
) -> None:
    """Draw points at values (V, runs), the runs of a row one below the other."""
    count, runs = values.shape
    offsets = SPREAD * ((np.arange(runs) + 0.5) / runs - 0.5)
    rows = np.arange(count)[:, None] + offsets
    look: dict[str, Any] = {"color": colour, "markersize": 4, "clip_on": False, "zorder": 3}
    panel.plot(values.ravel(), rows.ravel(), marker, label=label, **look)
