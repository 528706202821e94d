"""The figure of variants side by side: what is drawn where."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reproduction.plots.variants import plot_variants
from tests.helpers.figures import legend_of
from torch_pmil.plotting.style import VERMILLION

LABELS = ["ours", "never", "late", "best", "early"]
RATES = np.array([[0.7, 0.8], [0.0, 0.0], [0.5, 0.7], [1.0, 0.9], [0.6, 0.6]])
SECONDS = np.array([[10.0, 12.5], [np.inf, np.inf], [20.0, np.inf], [10.0, 7.5], [5.0, 7.5]])
ORDER = [0, 3, 4, 2, 1]


@pytest.fixture
def figure() -> Figure:
    return plot_variants(LABELS, RATES, SECONDS)


def points(figure: Figure, panel: int, marker: str) -> np.ndarray:
    """Values (V, runs) drawn with a marker, the rows from above."""
    (line,) = [
        line
        for line in figure.axes[panel].lines
        if isinstance(line, Line2D) and line.get_marker() == marker
    ]
    rows = np.round(line.get_ydata()).reshape(RATES.shape)
    np.testing.assert_array_equal(rows, np.arange(len(LABELS))[:, None] + np.zeros(2))
    return line.get_xdata().reshape(RATES.shape)


def test_ours_is_on_top_then_the_best_and_among_equals_the_one_that_needed_less(
    figure: Figure,
) -> None:
    """Every run is a point, in percent, and their mean a bar."""
    left, right = figure.axes
    labels = [tick.get_text() for tick in left.get_yticklabels()]
    assert labels == [LABELS[index] for index in ORDER]
    assert left.yaxis_inverted() and right.yaxis_inverted()
    np.testing.assert_array_equal(points(figure, 0, "o"), 100 * RATES[ORDER])
    means = [bar.get_width() for bar in left.patches]
    np.testing.assert_allclose(means, 100 * RATES[ORDER].mean(1))
    assert left.get_xlabel() == "success rate (%)"
    assert right.get_xlabel() == "experience before the first success (s)"


def test_runs_without_success_are_crosses_beyond_the_end(figure: Figure) -> None:
    seconds, panel = SECONDS[ORDER], figure.axes[1]
    np.testing.assert_array_equal(
        points(figure, 1, "o"), np.where(np.isfinite(seconds), seconds, np.nan)
    )
    crosses = points(figure, 1, "x")
    np.testing.assert_array_equal(np.isnan(crosses), np.isfinite(seconds))
    assert np.nanmin(crosses) > 20
    assert panel.get_xticklabels()[-1].get_text() == "never"
    assert panel.get_xticks()[-1] == np.nanmax(crosses) < panel.get_xlim()[1]
    assert legend_of(figure) == ["a run", "mean", "a run without success"]


def test_where_all_succeed_none_is_never_and_where_none_does_all_are() -> None:
    panel = plot_variants(LABELS, RATES, np.full(SECONDS.shape, 5.0)).axes[1]
    assert VERMILLION not in [line.get_color() for line in panel.lines]
    assert "never" not in [tick.get_text() for tick in panel.get_xticklabels()]
    failed = plot_variants(LABELS, RATES, np.full(SECONDS.shape, np.inf))
    assert np.isfinite(points(failed, 1, "x")).all()


def test_other_shapes_are_refused() -> None:
    complaint = r"must be \({0}, runs\) for {0} labels, got \(5, 2\), \(5, {1}\)"
    with pytest.raises(ValueError, match=complaint.format(3, 2)):
        plot_variants(LABELS[:3], RATES, SECONDS)
    with pytest.raises(ValueError, match=complaint.format(5, 1)):
        plot_variants(LABELS, RATES, SECONDS[:, :1])
