"""Figures: what is drawn where, in which unit, and files that are whole or absent."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure
from torch import Tensor

from reproduction.plots.photos import plot_photo_series
from tests.helpers.draws import Draws
from tests.helpers.figures import assert_edge, legend_of
from torch_pmil import plotting
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting import (
    pendulum_frames,
    plot_distributions,
    plot_learning_curve,
    plot_poses,
    plot_success_of_methods,
    plot_success_over_experience,
    save_figure,
)
from torch_pmil.plotting.style import BLUE, VERMILLION, panels_over_time

TIME_STEP = 0.1
NAMES, UNITS = ("x1", "y1", "q", "dq"), ("m", "m", "rad", "rad/s")
SHOWN = torch.linspace(-1, 1, 3 * 7 * 4, dtype=torch.float64).view(3, 7, 4)  # demonstrations


def make_belief(draws: Draws, dim: int = 4, std: float = 0.2) -> Gaussian:
    variances = std**2 * draws.uniform(0.5, 2.0, 6, dim)
    return Gaussian(draws.normal(6, dim), torch.diag_embed(variances))


def swing(count: int) -> Tensor:
    """Joints (count, 3, 2) of a stretched pendulum that goes from hanging to upright."""
    angle = torch.linspace(torch.pi, 0, count, dtype=torch.float64)
    along = torch.stack([angle.sin(), angle.cos()], -1)
    return along[:, None] * torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)[:, None]


def draw(demonstrated: Gaussian, predicted: Gaussian, executed: Tensor) -> Figure:
    dim = demonstrated.dim
    return plot_distributions(
        NAMES[:dim], UNITS[:dim], TIME_STEP, SHOWN[..., :dim], demonstrated, predicted, executed
    )


def test_every_name_of_the_room_is_there_when_it_is_asked_for() -> None:
    assert {"Figure", "Plane", "plot_policy"} <= set(dir(plotting))
    assert all(hasattr(plotting, name) for name in dir(plotting))
    with pytest.raises(AttributeError, match=r"No .* attribute plot_nothing"):
        plotting.plot_nothing  # noqa: B018


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_every_entry_has_a_panel_with_its_unit(draws: Draws, dim: int) -> None:
    belief = make_belief(draws, dim=dim)
    panels = draw(belief, belief, draws.normal(2, 7, dim)).axes
    labels = ["x1 (m)", "y1 (m)", "q (rad)", "dq (rad/s)"]
    assert [panel.get_ylabel() for panel in panels] == labels[:dim]
    assert panels[-1].get_xlabel() == "time (s)"


def edges(belief: Gaussian, entry: int) -> np.ndarray:
    """Both edges of two standard deviations at t = 1..T, (2, T)."""
    mean, std = belief.mean[:, entry].numpy(), belief.cov[:, entry, entry].sqrt().numpy()
    return np.stack([mean - 2 * std, mean + 2 * std])


def test_demonstrated_band_and_predicted_outline_reach_two_standard_deviations(
    draws: Draws,
) -> None:
    demonstrated, predicted = make_belief(draws), make_belief(draws)
    time = TIME_STEP * np.arange(1, 7)
    for entry, panel in enumerate(draw(demonstrated, predicted, draws.normal(2, 7, 4)).axes):
        (band,) = (
            drawn for drawn in panel.collections if isinstance(drawn, FillBetweenPolyCollection)
        )
        for edge in edges(demonstrated, entry):
            assert_edge(band, time, edge)
        outline = [line.get_xydata() for line in panel.lines if line.get_color() == VERMILLION]
        for drawn, edge in zip(outline[::2], edges(predicted, entry), strict=True):
            np.testing.assert_allclose(drawn, np.stack([time, edge], -1))


def test_only_the_demonstrated_is_filled(draws: Draws) -> None:
    figure = draw(make_belief(draws), make_belief(draws), draws.normal(2, 7, 4))
    labels = ["demonstrated ± 2 std", "demonstrations", "predicted ± 2 std", "all 2 rollouts"]
    assert legend_of(figure) == labels
    (demonstrated,) = figure.legends[0].get_patches()
    assert np.argmax(demonstrated.get_facecolor()[:3]) == 2


def test_demonstrations_and_few_rollouts_are_drawn_from_the_start(draws: Draws) -> None:
    executed = draws.normal(9, 7, 4)
    figure = draw(make_belief(draws), make_belief(draws), executed)
    panel, time = figure.axes[1], TIME_STEP * np.arange(7)
    dashed = [line.get_xydata() for line in panel.lines if line.is_dashed()]
    thin = [line.get_xydata() for line in panel.lines if line.get_color() == BLUE]
    for drawn, paths in ((dashed, executed[:5]), (thin[1:], SHOWN)):  # the first is the mean
        np.testing.assert_allclose(drawn, [np.stack([time, path], -1) for path in paths[..., 1]])
    assert legend_of(figure)[-1] == "the first 5 of 9 rollouts"


def test_without_rollouts_the_distributions_are_drawn_alone(draws: Draws) -> None:
    assert len(legend_of(draw(make_belief(draws), make_belief(draws), torch.zeros(0, 7, 4)))) == 3


def test_prediction_that_is_not_there_is_said_to_be_missing(draws: Draws, tmp_path: Path) -> None:
    belief = make_belief(draws)
    nothing = Gaussian(belief.mean * torch.nan, belief.cov * torch.nan)
    figure = draw(belief, nothing, draws.normal(2, 7, 4))
    assert legend_of(figure)[2] == "no prediction"
    save_figure(figure, tmp_path / "figure.png")


@pytest.mark.parametrize("dim", range(1, 11))
def test_grid_of_panels_has_no_empty_place(dim: int) -> None:
    figure, panels = panels_over_time(dim * ["x"])
    grid = panels[0].get_gridspec()
    assert grid.nrows * grid.ncols == dim == len(panels) == len(figure.axes)


@pytest.mark.parametrize("std", [1e-4, 1e3])
def test_the_demonstrated_band_stays_readable_beside_any_prediction(
    draws: Draws, std: float
) -> None:
    demonstrated = make_belief(draws)
    panels = draw(demonstrated, make_belief(draws, std=std), draws.normal(2, 7, 4)).axes
    for entry, panel in enumerate(panels):
        bottom, top = panel.get_ylim()
        seen = edges(demonstrated, entry)
        assert bottom < seen.min() and seen.max() < top
        assert top - bottom < 20


def test_a_prediction_with_a_graph_is_drawn(draws: Draws) -> None:
    belief = make_belief(draws)
    draw(belief, Gaussian(belief.mean.requires_grad_(), belief.cov), draws.normal(2, 7, 4))


def test_learning_curve_is_in_percent_seconds_and_nats() -> None:
    losses = [np.nan, 1e3, 10.0]
    rates, divergences = plot_learning_curve([2.5, 5.0, 7.5], [0.0, 0.5, 1.0], losses).axes
    curves = [line for line in rates.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(curves[0].get_xydata(), [[2.5, 0], [5, 50], [7.5, 100]])
    np.testing.assert_array_equal(divergences.lines[0].get_ydata(), losses)
    assert rates.get_ylim() == (0, 100)
    assert divergences.get_yscale() == "log"
    labels = rates.get_ylabel(), divergences.get_ylabel(), divergences.get_xlabel()
    assert labels == ("success rate (%)", "predicted KL (nats)", "experience (s)")
    assert [line.get_ydata() for line in rates.lines if line.get_linestyle() == ":"] == [[95, 95]]


def test_learning_curve_of_single_rollouts_and_another_loss_is_labelled_so() -> None:
    upper, lower = plot_learning_curve(
        [2.5, 5.0], [0.0, 1.0], [9.0, 2.0], "predicted cost", of_one_rollout=True
    ).axes
    (points,) = upper.lines
    assert points.get_linestyle() == "None"
    assert [label.get_text() for label in upper.get_yticklabels()] == ["failed", "succeeded"]
    assert lower.get_ylabel() == "predicted cost"


@pytest.mark.parametrize(
    ("kl", "missing"),
    [([np.nan, np.nan], [2.5, 5.0]), ([0.0, 1.0], [2.5]), ([2.0, np.inf], [5.0])],
    ids=str,
)
def test_learning_curve_has_a_cross_for_what_has_no_logarithm(
    kl: list[float], missing: list[float], tmp_path: Path
) -> None:
    figure = plot_learning_curve([2.5, 5.0], [0.0, 0.5], kl)
    (crosses,) = [line for line in figure.axes[1].lines if line.get_marker() == "x"]
    assert list(crosses.get_xdata()) == missing
    assert legend_of(figure) == ["no value"]
    save_figure(figure, tmp_path / "curve.png")


@pytest.mark.parametrize("loss", [2.0, np.nan])
def test_learning_curve_ends_with_the_saved_policy(loss: float, tmp_path: Path) -> None:
    figure = plot_learning_curve([2.5, 5.0], [0.0, 0.5], [9.0, 5.0], saved=(7.5, 1.0, loss))
    stars = [line.get_xydata() for panel in figure.axes for line in panel.lines[1:]]
    np.testing.assert_array_equal(stars[-2:], [[[7.5, 100]], [[7.5, loss]]])
    assert figure.axes[1].get_xlim()[1] > 7.5
    save_figure(figure, tmp_path / "curve.png")


@pytest.mark.parametrize(
    ("losses", "shown"),
    [([40.0, 14.0], {"20", "30", "40"}), ([1000.0, 2.0], {"10", "100", "1000"})],
)
def test_loss_has_plain_numbers_on_its_axis(losses: list[float], shown: set[str]) -> None:
    axis = plot_learning_curve([2.5, 5.0], [0.0, 0.5], losses).axes[1].yaxis
    labels = {axis.get_major_formatter()(at) for at in axis.get_majorticklocs()} | {
        axis.get_minor_formatter()(at) for at in axis.get_minorticklocs()
    }
    assert shown <= labels and not any("e" in label or "$" in label for label in labels if label)


def test_every_pose_is_drawn_from_the_base_in_its_colour() -> None:
    panel, colourbar = plot_poses(swing(5), TIME_STEP).axes
    poses = [line for line in panel.lines if len(line.get_xdata()) == 3]
    np.testing.assert_allclose([line.get_xydata() for line in poses], swing(5))
    assert len({line.get_color() for line in poses}) == 5
    assert panel.get_aspect() == 1
    labels = panel.get_xlabel(), panel.get_ylabel(), colourbar.get_ylabel()
    assert labels == ("x (m)", "y (m)", "time (s)")
    assert colourbar.get_ylim() == pytest.approx((0, 4 * TIME_STEP))


def test_pendulum_frames_are_pictures_of_the_asked_size_that_move() -> None:
    frames = list(pendulum_frames(swing(4), 0.02, size=101))
    assert [frame.shape for frame in frames] == [(101, 101, 3)] * 4
    assert {frame.dtype for frame in frames} == {np.dtype(np.uint8)}
    assert all((frame != following).any() for frame, following in pairwise(frames))


def test_pendulum_is_drawn_with_up_on_top() -> None:
    hanging, upright = (
        next(pendulum_frames(swing(2)[[index]], 0.02, size=100)) for index in (0, 1)
    )
    for frame, drawn, empty in (
        (upright, slice(15, 45), slice(60, 85)),
        (hanging, slice(55, 85), slice(15, 40)),
    ):
        white = (frame[:, 50] == 255).all(-1)
        assert not white[drawn].any()
        assert white[empty].all()


def test_figure_that_cannot_be_drawn_leaves_the_old_file(tmp_path: Path) -> None:
    path, figure = tmp_path / "figure.png", Figure()
    path.write_text("old")
    figure.text(0.5, 0.5, r"$\nothing$")
    with pytest.raises(ValueError, match="nothing"):
        save_figure(figure, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_success_over_experience_is_the_mean_of_the_runs_with_its_interval_in_percent() -> None:
    experience, rates = np.array([2.5, 5.0, 7.5]), np.array([[0.0, 1.0, 1.0], [0.0, 0.0, 0.5]])
    lower, upper = np.array([0.0, 0.2, 0.4]), np.array([0.3, 0.8, 0.9])
    panel = plot_success_over_experience(experience, rates, lower, upper).axes[0]
    (mean,) = [line for line in panel.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(mean.get_xydata(), [[2.5, 0], [5, 50], [7.5, 75]])
    single = [line.get_ydata() for line in panel.lines if line.get_linewidth() == 0.7]
    np.testing.assert_array_equal(single, 100 * rates)
    for edge in (lower, upper):
        assert_edge(panel.collections[0], experience, 100 * edge)
    labels = panel.get_xlabel(), panel.get_ylabel(), panel.get_ylim()
    assert labels == ("experience (s)", "success rate (%)", (0, 100))


def test_every_method_has_its_own_mean_and_interval_in_percent(tmp_path: Path) -> None:
    experience, half = np.array([2.5, 5.0]), np.full(2, 0.1)
    means = {"a": np.array([0.2, 0.9]), "b": np.array([0.5, 0.5])}
    figure = plot_success_of_methods(
        {name: (experience, mean, mean - half, mean + half) for name, mean in means.items()}
    )
    (panel,) = figure.axes
    drawn = {line.get_label(): line for line in panel.lines}
    for (name, mean), band in zip(means.items(), panel.collections, strict=True):
        np.testing.assert_allclose(drawn[name].get_xydata(), np.stack([experience, 100 * mean], -1))
        for edge in (mean - half, mean + half):
            assert_edge(band, experience, 100 * edge)
    assert drawn["a"].get_color() != drawn["b"].get_color()
    assert drawn["a"].get_marker() != drawn["b"].get_marker()
    assert legend_of(figure) == ["a", "b"]
    labels = panel.get_xlabel(), panel.get_ylabel(), panel.get_ylim()
    assert labels == ("experience (s)", "success rate (%)", (0, 100))
    save_figure(figure, tmp_path / "methods.png")


def test_each_picture_is_in_its_row_and_below_its_time() -> None:
    black, dark, grey, light = (np.full((8, 8, 3), shade, np.uint8) for shade in (0, 50, 100, 150))
    panels = plot_photo_series({"shown": [black, dark], "learned": [grey, light]}, (0.0, 1.25)).axes
    assert [panel.images[0].get_array()[0, 0, 0] for panel in panels] == [0, 50, 100, 150]
    assert [panel.get_title() for panel in panels[:2]] == ["0.00 s", "1.25 s"]
    assert [panel.get_ylabel() for panel in panels[::2]] == ["shown", "learned"]
