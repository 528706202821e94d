"""The figures of the method's parts: what is drawn where."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from reproduction.plots.gaussian_process import plot_gp, plot_moment_matching
from tests.helpers.draws import Draws
from tests.helpers.figures import assert_edge, corners_of
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting import plot_demonstrations, plot_prediction

NAMED = ("x", "y"), ("m", "m"), 0.1


def posterior_of(draws: Draws, points: int) -> Gaussian:
    return Gaussian(draws.normal(points, 1), draws.uniform(0.5, 2.0, points, 1, 1))


def trajectory_of(draws: Draws) -> Gaussian:
    return Gaussian(draws.normal(5, 2), torch.diag_embed(draws.uniform(0.5, 2.0, 5, 2)))


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


def test_densities_of_input_and_output_have_unit_area_and_the_right_mean(draws: Draws) -> None:
    grid = torch.linspace(-6, 6, 300).double()
    belief = Gaussian(torch.tensor([0.5]).double(), torch.tensor([[0.8]]).double())
    matched = Gaussian(torch.tensor([-1.0]).double(), torch.tensor([[0.3]]).double())
    _, output, source, _ = plot_moment_matching(
        grid, posterior_of(draws, 300), belief, draws.normal(5000), matched
    ).axes
    density, height = output.lines[0].get_xdata(), output.lines[0].get_ydata()
    assert np.trapezoid(density, height) == pytest.approx(1, abs=5e-3)
    assert np.trapezoid(density * height, height) == pytest.approx(-1, abs=5e-3)
    area = sum(patch.get_width() * patch.get_height() for patch in output.patches)
    assert area == pytest.approx(1)
    corners = corners_of(source.collections[0])
    assert corners[corners[:, 1].argmax(), 0] == pytest.approx(0.5, abs=0.03)
    assert corners[:, 1].max() == pytest.approx(1 / np.sqrt(2 * np.pi * 0.8), rel=1e-3)


def test_demonstrations_are_dashed_lines_and_their_distribution_a_band_from_the_first_step(
    draws: Draws,
) -> None:
    demonstrations, demonstrated = draws.normal(3, 6, 2), trajectory_of(draws)
    panels = plot_demonstrations(*NAMED, demonstrations, demonstrated).axes
    for entry, panel in enumerate(panels):
        dashed = np.stack([line.get_xydata() for line in panel.lines if line.is_dashed()])
        np.testing.assert_allclose(dashed[..., 0], np.tile(0.1 * np.arange(6), (3, 1)))
        np.testing.assert_array_equal(dashed[..., 1], demonstrations[..., entry].numpy())
        upper = demonstrated.mean[:, entry] + 2 * demonstrated.cov[:, entry, entry].sqrt()
        assert_edge(panel.collections[0], 0.1 * np.arange(1, 6), upper.numpy())


def test_prediction_is_a_band_and_particles_are_dashed_moments_and_the_first_twenty_as_lines(
    draws: Draws,
) -> None:
    particles, predicted = draws.normal(50, 5, 2), trajectory_of(draws)
    time, edge = 0.1 * np.arange(1, 6), (predicted.mean + 2 * predicted.std).numpy()
    for entry, panel in enumerate(plot_prediction(*NAMED, predicted, particles).axes):
        assert_edge(panel.collections[0], time, edge[:, entry])
        dashed = np.stack([line.get_xydata() for line in panel.lines if line.is_dashed()])
        mean, reach = particles[..., entry].mean(0), 2 * particles[..., entry].std(0)
        np.testing.assert_allclose(dashed[..., 0], np.tile(time, (3, 1)))
        np.testing.assert_allclose(dashed[..., 1], torch.stack([mean - reach, mean, mean + reach]))
        lines = [line.get_ydata() for line in panel.lines if not line.is_dashed()]
        np.testing.assert_array_equal(lines[1:], particles[:20, :, entry])  # after the mean
