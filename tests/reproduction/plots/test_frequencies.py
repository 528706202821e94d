"""The figure of scores over frequencies: what is drawn where."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction.plots.frequencies import plot_frequencies

FREQUENCIES = [2.0, 10.0, 50.0]
SCORES = {
    "raw": ([1.0, 2.0, 3.0], [0.1, 0.2, 0.3]),
    "standardised": ([-1.0, 0.5, 0.0], [0.3, 0.2, 0.1]),
}


def test_each_form_has_a_panel_with_its_means_and_intervals() -> None:
    figure = plot_frequencies(FREQUENCIES, SCORES)
    assert [panel.get_title() for panel in figure.axes] == list(SCORES)
    for panel, (means, half_widths) in zip(figure.axes, SCORES.values(), strict=True):
        (drawn,) = panel.containers
        line, _, (bars,) = drawn.lines
        np.testing.assert_allclose(line.get_xydata(), np.stack([FREQUENCIES, means], 1))
        ends = np.array(bars.get_segments())[..., 1]
        np.testing.assert_allclose(
            ends, np.stack([np.subtract(means, half_widths), np.add(means, half_widths)], 1)
        )
        assert panel.get_xscale() == "log"
        assert [tick.get_text() for tick in panel.get_xticklabels()] == ["2", "5", "10", "20", "50"]


def test_other_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="raw must have 3 means and half widths, got 2 and 3"):
        plot_frequencies(FREQUENCIES, {"raw": ([1.0, 2.0], [0.1, 0.2, 0.3])})
