"""The figures of the method's parts, and of success over mass: what is drawn where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.collections import FillBetweenPolyCollection

from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting import (
    plot_demonstrations,
    plot_gp,
    plot_moment_matching,
    plot_prediction,
    plot_success_over_mass,
    plot_success_over_settings,
    save_figure,
)

MASSES = [0.3, 0.5, 0.8]


def corners_of(band: FillBetweenPolyCollection) -> np.ndarray:
    return band.get_paths()[0].vertices


def assert_edge(band: FillBetweenPolyCollection, x: np.ndarray, y: np.ndarray) -> None:
    distances = np.abs(corners_of(band)[None] - np.stack([x, y], -1)[:, None]).max(-1)
    np.testing.assert_allclose(distances.min(1), 0, atol=1e-12)


def posterior_of(draws: Draws, points: int) -> Gaussian:
    return Gaussian(draws.normal(points, 1), draws.uniform(0.5, 2.0, points, 1, 1))


def test_gp_band_reaches_two_standard_deviations_around_the_mean(draws: Draws) -> None:
    grid, posterior = torch.linspace(-1, 1, 7).double(), posterior_of(draws, 7)
    panel = plot_gp(draws.normal(4), draws.normal(4), grid, posterior, 0.5).axes[0]
    mean, std = posterior.mean[:, 0].numpy(), posterior.cov[:, 0, 0].sqrt().numpy()
    for sign in (-2, 2):
        assert_edge(panel.collections[0], grid.numpy(), mean + sign * std)
    np.testing.assert_array_equal(panel.lines[0].get_ydata(), mean)


def test_gp_data_are_crosses_and_the_test_input_is_a_line(draws: Draws) -> None:
    inputs, targets = draws.normal(4), draws.normal(4)
    panel = plot_gp(inputs, targets, torch.arange(3.0), posterior_of(draws, 3), 0.5).axes[0]
    (crosses,) = [line for line in panel.lines if line.get_marker() == "x"]
    np.testing.assert_array_equal(crosses.get_xydata(), torch.stack([inputs, targets], -1).numpy())
    assert list(panel.lines[-1].get_xdata()) == [0.5, 0.5]


def test_gp_of_other_shapes_is_refused(draws: Draws) -> None:
    with pytest.raises(
        ValueError, match=r"inputs and targets must be \(n,\) each, got \(4,\) and \(3,\)"
    ):
        plot_gp(draws.normal(4), draws.normal(3), torch.arange(3.0), posterior_of(draws, 3), 0.5)
    with pytest.raises(
        ValueError, match=r"posterior must have a mean of shape \(3, 1\), .* got \(4, 1\)"
    ):
        plot_gp(draws.normal(4), draws.normal(4), torch.arange(3.0), posterior_of(draws, 4), 0.5)


def test_densities_of_input_and_output_have_unit_area_and_the_right_mean(draws: Draws) -> None:
    grid = torch.linspace(-6, 6, 300).double()
    belief = Gaussian(torch.tensor([0.5]).double(), torch.tensor([[0.8]]).double())
    matched = Gaussian(torch.tensor([-1.0]).double(), torch.tensor([[0.3]]).double())
    figure = plot_moment_matching(
        grid, posterior_of(draws, 300), belief, draws.normal(5000), matched
    )
    _, output, source = figure.axes[0], figure.axes[1], figure.axes[2]
    density, height = output.lines[0].get_xdata(), output.lines[0].get_ydata()
    assert np.trapezoid(density, height) == pytest.approx(1, abs=5e-3)
    assert np.trapezoid(density * height, height) == pytest.approx(-1, abs=5e-3)
    area = sum(patch.get_width() * patch.get_height() for patch in output.patches)
    assert area == pytest.approx(1)
    corners = corners_of(source.collections[0])
    assert corners[corners[:, 1].argmax(), 0] == pytest.approx(0.5, abs=0.03)
    assert corners[:, 1].max() == pytest.approx(1 / np.sqrt(2 * np.pi * 0.8), rel=1e-3)


def test_moment_matching_of_several_entries_is_refused(draws: Draws) -> None:
    two, one = Gaussian(torch.zeros(2), torch.eye(2)), Gaussian(torch.zeros(1), torch.eye(1))
    with pytest.raises(
        ValueError,
        match=r"belief and matched must be of one entry and samples \(S,\), got \(2,\), \(1,\) "
        r"and \(9,\)",
    ):
        plot_moment_matching(torch.arange(3.0), posterior_of(draws, 3), two, draws.normal(9), one)


def test_demonstrations_are_dashed_lines_and_their_distribution_a_band_from_the_first_step(
    draws: Draws,
) -> None:
    demonstrations = draws.normal(3, 6, 2)
    demonstrated = Gaussian(draws.normal(5, 2), torch.diag_embed(draws.uniform(0.5, 2.0, 5, 2)))
    for entry, panel in enumerate(
        plot_demonstrations(("x", "y"), ("m", "m"), 0.1, demonstrations, demonstrated).axes
    ):
        dashed = [line.get_xydata() for line in panel.lines if line.is_dashed()]
        np.testing.assert_allclose(np.stack(dashed)[..., 0], np.tile(0.1 * np.arange(6), (3, 1)))
        np.testing.assert_array_equal(np.stack(dashed)[..., 1], demonstrations[..., entry].numpy())
        upper = demonstrated.mean[:, entry] + 2 * demonstrated.cov[:, entry, entry].sqrt()
        assert_edge(panel.collections[0], 0.1 * np.arange(1, 6), upper.numpy())


def test_demonstrations_of_another_length_are_refused(draws: Draws) -> None:
    demonstrated = Gaussian(torch.zeros(5, 1), torch.ones(5, 1, 1))
    with pytest.raises(
        ValueError,
        match=r"demonstrations must be \(N, 6, 1\) for demonstrated marginals \(5, 1\), .* got "
        r"\(3, 5, 1\)",
    ):
        plot_demonstrations(("x",), ("m",), 0.1, draws.normal(3, 5, 1), demonstrated)


def test_prediction_is_a_band_and_particles_are_dashed_moments_and_the_first_twenty_as_lines(
    draws: Draws,
) -> None:
    particles = draws.normal(50, 5, 2)
    predicted = Gaussian(draws.normal(5, 2), torch.diag_embed(draws.uniform(0.5, 2.0, 5, 2)))
    time = 0.1 * np.arange(1, 6)
    for entry, panel in enumerate(
        plot_prediction(("x", "y"), ("m", "m"), 0.1, predicted, particles).axes
    ):
        assert_edge(
            panel.collections[0], time, (predicted.mean + 2 * predicted.std)[:, entry].numpy()
        )
        dashed = np.stack([line.get_xydata() for line in panel.lines if line.is_dashed()])
        mean, reach = particles[..., entry].mean(0), 2 * particles[..., entry].std(0)
        np.testing.assert_allclose(dashed[..., 0], np.tile(time, (3, 1)))
        np.testing.assert_allclose(dashed[..., 1], torch.stack([mean - reach, mean, mean + reach]))
        lines = np.stack(
            [line.get_ydata() for line in panel.lines if not line.is_dashed()][1:]
        )  # the first is the predicted mean
        np.testing.assert_array_equal(lines, particles[:20, :, entry])


def test_particles_of_another_length_are_refused(draws: Draws) -> None:
    predicted = Gaussian(torch.zeros(5, 1), torch.ones(5, 1, 1))
    with pytest.raises(
        ValueError,
        match=r"particles must be \(N, 5, 1\) with N of at least 2 .* got \(3, 6, 1\), 1 names "
        r"and 1 units",
    ):
        plot_prediction(("x",), ("m",), 0.1, predicted, draws.normal(3, 6, 1))


def test_success_over_mass_is_the_mean_in_percent_with_the_range_over_the_runs(
    tmp_path: Path,
) -> None:
    rates = {"a": np.array([[0.0, 1.0, 0.5], [0.5, 1.0, 0.5]]), "b": np.ones((1, 3))}
    figure = plot_success_over_mass(
        MASSES, rates, np.array([[2.0, 3.0, 4.0], [3.0, 3.0, 5.0]]), limit=3.5, demonstrated=0.5
    )
    upper, lower = figure.axes
    first, second = upper.containers
    np.testing.assert_allclose(first.lines[0].get_xydata(), [[0.3, 25], [0.5, 100], [0.8, 50]])
    np.testing.assert_allclose(
        [segment[:, 1] for segment in first.lines[2][0].get_segments()],
        [[0, 50], [100, 100], [50, 50]],
    )
    assert (first.get_label(), second.get_label()) == ("a", "b")
    assert first.lines[0].get_color() != second.lines[0].get_color()
    np.testing.assert_allclose(lower.containers[0].lines[0].get_ydata(), [2.5, 3, 4.5])
    assert [3.5, 3.5] in [list(line.get_ydata()) for line in lower.lines]
    assert [0.5, 0.5] in [list(line.get_xdata()) for line in lower.lines]
    save_figure(figure, tmp_path / "mass.png")


def test_success_of_another_number_of_masses_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"rates and torques must be \(runs, 3\) for 3 masses, got .*\(1, 2\)"
    ):
        plot_success_over_mass(
            MASSES, {"a": np.ones((1, 2))}, np.ones((1, 3)), limit=3.5, demonstrated=0.5
        )


def test_each_setting_has_its_panel_with_the_mean_in_percent_and_the_range_over_the_runs(
    tmp_path: Path,
) -> None:
    panels = {
        "noise (rad)": ([0.0, 0.1], np.array([[1.0, 0.5], [0.5, 0.0]])),
        "demonstrations": ([2, 5, 10], np.ones((2, 3))),
    }
    figure = plot_success_over_settings(panels, plain=[0.0, 5])
    first, second = figure.axes
    np.testing.assert_allclose(first.containers[0].lines[0].get_xydata(), [[0.0, 75], [0.1, 25]])
    np.testing.assert_allclose(
        [segment[:, 1] for segment in first.containers[0].lines[2][0].get_segments()],
        [[50, 100], [0, 50]],
    )
    np.testing.assert_allclose(
        second.containers[0].lines[0].get_xydata(), [[2, 100], [5, 100], [10, 100]]
    )
    assert [panel.get_xlabel() for panel in figure.axes] == list(panels)
    assert [5, 5] in [list(line.get_xdata()) for line in second.lines]
    save_figure(figure, tmp_path / "settings.png")


def test_success_of_another_number_of_levels_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"rates over noise must be \(runs, 2\) for 2 levels, got \(2, 3\)"
    ):
        plot_success_over_settings({"noise": ([0.0, 0.1], np.ones((2, 3)))}, plain=[0.0])
