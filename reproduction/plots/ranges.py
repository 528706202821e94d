"""The mean of several runs with the range over them, in a panel of a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes


def draw_range(
    panel: Axes,
    x: Sequence[float],
    values: np.ndarray,
    colour: str,
    marker: str,
    label: str,
    size: int = 1,
) -> None:
    """Draw the mean of values (runs, K), with the range over the runs as error bars."""
    mean = values.mean(0)
    bars = np.stack([mean - values.min(0), values.max(0) - mean])
    weight: dict[str, Any] = {
        "markersize": 1 + 3 * size,
        "linewidth": 1.6 * size,
        "elinewidth": 0.8 * size,
        "capsize": 2 * size,
    }
    drawn = panel.errorbar(x, mean, bars, color=colour, marker=marker, label=label, **weight)
    for artist in drawn.get_children():
        artist.set_clip_on(False)
