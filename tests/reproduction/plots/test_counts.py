"""The figure of counts: bars side by side, kinds that were counted."""

from __future__ import annotations

import pytest

from reproduction.plots.counts import plot_counts

TABLE = {"one": {"a": 1, "b": 0, "c": 3}, "two": {"a": 2, "b": 0, "c": 0}}


def test_bars_of_a_row_lie_end_to_end_and_kinds_without_a_count_are_left_out() -> None:
    (panel,) = plot_counts(TABLE, "runs").axes
    bars = [(bar.get_x(), bar.get_width()) for bars in panel.containers for bar in bars]
    assert bars == [(0, 1), (0, 2), (1, 3), (2, 0)]
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["a", "c"]
    assert panel.yaxis_inverted() and panel.get_xlabel() == "number of runs"


def test_rows_must_have_the_same_kinds() -> None:
    with pytest.raises(ValueError, match="all rows must have the same kinds"):
        plot_counts(TABLE | {"three": {"a": 1}}, "runs")
    with pytest.raises(ValueError, match="table must hold one at least, got none"):
        plot_counts({}, "runs")
