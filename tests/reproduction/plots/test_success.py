"""The figures of success over mass and over settings: what is drawn where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer

from reproduction.plots.success import plot_success_over_mass, plot_success_over_settings
from torch_pmil.plotting import save_figure

MASSES = [0.3, 0.5, 0.8]


def means_and_ranges(drawn: ErrorbarContainer) -> tuple[np.ndarray, list[np.ndarray]]:
    return drawn.lines[0].get_xydata(), [bar[:, 1] for bar in drawn.lines[2][0].get_segments()]


def test_success_over_mass_is_the_mean_in_percent_with_the_range_over_the_runs(
    tmp_path: Path,
) -> None:
    rates = {"a": np.array([[0.0, 1.0, 0.5], [0.5, 1.0, 0.5]]), "b": np.ones((1, 3))}
    torques = np.array([[2.0, 3.0, 4.0], [3.0, 3.0, 5.0]])
    figure = plot_success_over_mass(MASSES, rates, torques, limit=3.5, demonstrated=0.5)
    upper, lower = figure.axes
    first, second = upper.containers
    means, ranges = means_and_ranges(first)
    np.testing.assert_allclose(means, [[0.3, 25], [0.5, 100], [0.8, 50]])
    np.testing.assert_allclose(ranges, [[0, 50], [100, 100], [50, 50]])
    assert (first.get_label(), second.get_label()) == ("a", "b")
    assert first.lines[0].get_color() != second.lines[0].get_color()
    np.testing.assert_allclose(lower.containers[0].lines[0].get_ydata(), [2.5, 3, 4.5])
    assert [3.5, 3.5] in [list(line.get_ydata()) for line in lower.lines]
    assert [0.5, 0.5] in [list(line.get_xdata()) for line in lower.lines]
    save_figure(figure, tmp_path / "mass.png")


def test_each_setting_has_its_panel_with_the_mean_in_percent_and_the_range_over_the_runs(
    tmp_path: Path,
) -> None:
    panels = {
        "noise (rad)": ([0.0, 0.1], np.array([[1.0, 0.5], [0.5, 0.0]])),
        "demonstrations": ([2, 5, 10], np.ones((2, 3))),
    }
    figure = plot_success_over_settings(panels, plain=[0.0, 5])
    first, second = figure.axes
    means, ranges = means_and_ranges(first.containers[0])
    np.testing.assert_allclose(means, [[0.0, 75], [0.1, 25]])
    np.testing.assert_allclose(ranges, [[50, 100], [0, 50]])
    means, _ = means_and_ranges(second.containers[0])
    np.testing.assert_allclose(means, [[2, 100], [5, 100], [10, 100]])
    assert [panel.get_xlabel() for panel in figure.axes] == list(panels)
    assert [5, 5] in [list(line.get_xdata()) for line in second.lines]
    save_figure(figure, tmp_path / "settings.png")


def test_rates_that_do_not_fit_are_refused() -> None:
    message = r"rates and torques must be \(runs, 3\) for 3 masses, got .*\(1, 2\)"
    with pytest.raises(ValueError, match=message):
        plot_success_over_mass(MASSES, {"a": np.ones((1, 2))}, np.ones((1, 3)), 3.5, 0.5)
    message = r"rates over noise must be \(runs, 2\) for 2 levels, got \(2, 3\)"
    with pytest.raises(ValueError, match=message):
        plot_success_over_settings({"noise": ([0.0, 0.1], np.ones((2, 3)))}, plain=[0.0])
