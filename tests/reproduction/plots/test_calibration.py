"""The figure of measured over predicted success rates: what is drawn where."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction.plots.calibration import plot_success_calibration


def test_trials_are_points_and_bins_have_their_intervals_in_percent() -> None:
    drawn = {"trials": [(0.9, 1.0), (0.8, 0.6)], "bins": [(0.85, 0.8, 0.7, 0.95)]}
    before, after = plot_success_calibration({"before": drawn, "after": drawn}).axes
    assert (before.get_title(), after.get_title()) == ("before", "after")
    _, trials, bins = before.lines[:3]
    np.testing.assert_allclose(trials.get_xydata(), [[90, 100], [80, 60]])
    np.testing.assert_allclose(bins.get_xydata(), [[85, 80]])
    (container,) = before.containers
    (segment,) = container.lines[2][0].get_segments()
    np.testing.assert_allclose(segment, [[85, 70], [85, 95]])


def test_there_must_be_a_prediction() -> None:
    with pytest.raises(ValueError, match="predictions must hold one at least, got none"):
        plot_success_calibration({})
