"""Figure of scores over sampling frequencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator

from torch_pmil.plotting.style import BLUE, check_some, style

TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # Hz


def plot_frequencies(
    frequencies: Sequence[float], scores: Mapping[str, tuple[Sequence[float], Sequence[float]]]
) -> Figure:
    """Predictive log-likelihood with its interval over the sampling frequency (Figure 9).

    There is one panel for each form of the score.

    Args:
        frequencies: F frequencies in Hz.
        scores: means and half widths of their intervals, F each, in nats for each transition and
            output, by the title of their panel.

    Raises:
        ValueError: there are not as many scores as frequencies.

    Example:
        >>> figure = plot_frequencies([5, 10], {"raw": ([0.0, 1.0], [0.1, 0.1])})
        >>> figure.axes[0].get_title()
        'raw'
    """
    for title, (means, half_widths) in scores.items():
        if not len(means) == len(half_widths) == len(frequencies):
            raise ValueError(
                f"{title} must have {len(frequencies)} means and half widths, got {len(means)} and "
                f"{len(half_widths)}"
            )
    check_some("scores", scores)
    figure = Figure(figsize=(0.8 + 3.6 * len(scores), 3.0), layout="constrained")
    for index, (title, (means, half_widths)) in enumerate(scores.items()):
        panel = figure.add_subplot(1, len(scores), index + 1)
        look: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 4, "linewidth": 1.2}
        panel.errorbar(frequencies, means, half_widths, capsize=3, **look)
        panel.set(title=title, xscale="log", xlabel="sampling frequency (Hz)")
        ticks = [tick for tick in TICKS if min(frequencies) <= tick <= max(frequencies)]
        panel.set_xticks(ticks, [f"{tick}" for tick in ticks])
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_minor_formatter(NullFormatter())
        style(panel)
    figure.axes[0].set_ylabel("log-likelihood (nats)")
    return figure
