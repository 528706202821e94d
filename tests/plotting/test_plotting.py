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

from tests.helpers.draws import Draws
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
from torch_pmil.plotting.style import BLUE, VERMILLION, panels_of

TIME_STEP = 0.1
NAMES, UNITS = ("x1", "y1", "q", "dq"), ("m", "m", "rad", "rad/s")
SHOWN = torch.linspace(-1, 1, 3 * 7 * 4, dtype=torch.float64).view(3, 7, 4)  # demonstrations


def make_belief(draws: Draws, steps: int = 6, dim: int = 4, std: float = 0.2) -> Gaussian:
    return Gaussian(
        draws.normal(steps, dim), torch.diag_embed(std**2 * draws.uniform(0.5, 2.0, steps, dim))
    )


def swing(count: int) -> Tensor:
    """Link ends (count, 4) of a stretched pendulum that goes from hanging to upright."""
    angle = torch.linspace(torch.pi, 0, count, dtype=torch.float64)
    return torch.stack([angle.sin() / 2, angle.cos() / 2, angle.sin(), angle.cos()], -1)


def draw(demonstrated: Gaussian, predicted: Gaussian, executed: Tensor) -> Figure:
    dim = demonstrated.dim
    return plot_distributions(
        NAMES[:dim], UNITS[:dim], TIME_STEP, SHOWN[..., :dim], demonstrated, predicted, executed
    )


def test_every_name_of_the_room_is_there_when_it_is_asked_for() -> None:
    assert {"Figure", "Plane", "plot_policy"} <= set(dir(plotting))
    assert all(hasattr(plotting, name) for name in dir(plotting))
    with pytest.raises(AttributeError, match="no attribute 'plot_nothing'"):
        plotting.plot_nothing  # noqa: B018


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_every_entry_has_a_panel_with_its_unit(draws: Draws, dim: int) -> None:
    belief = make_belief(draws, dim=dim)
    panels = draw(belief, belief, draws.normal(2, 7, dim)).axes
    assert [panel.get_ylabel() for panel in panels] == [
        f"{name} ({unit})" for name, unit in zip(NAMES[:dim], UNITS[:dim], strict=True)
    ]
    assert panels[-1].get_xlabel() == "time (s)"


def edges(belief: Gaussian, entry: int) -> np.ndarray:
    """Both edges of two standard deviations at t = 1..T, (2, T, 2), with their times."""
    mean, std = belief.mean[:, entry].numpy(), belief.cov[:, entry, entry].sqrt().numpy()
    time = TIME_STEP * np.arange(1, 7)
    return np.stack([np.stack([time, edge], -1) for edge in (mean - 2 * std, mean + 2 * std)])


def test_demonstrated_band_and_predicted_outline_reach_two_standard_deviations(
    draws: Draws,
) -> None:
    demonstrated, predicted = make_belief(draws), make_belief(draws)
    for entry, panel in enumerate(draw(demonstrated, predicted, draws.normal(2, 7, 4)).axes):
        (band,) = (
            drawn for drawn in panel.collections if isinstance(drawn, FillBetweenPolyCollection)
        )
        corners = band.get_paths()[0].vertices
        for edge in edges(demonstrated, entry):
            distances = np.abs(corners[None] - edge[:, None]).max(-1)
            np.testing.assert_allclose(distances.min(1), 0, atol=1e-12)
        lower, _, upper = (
            line.get_xydata() for line in panel.lines if line.get_color() == VERMILLION
        )
        np.testing.assert_allclose([lower, upper], edges(predicted, entry))


def test_only_the_demonstrated_is_filled(draws: Draws) -> None:
    figure = draw(make_belief(draws), make_belief(draws), draws.normal(2, 7, 4))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [
        "demonstrated ± 2 std",
        "demonstrations",
        "predicted ± 2 std",
        "all 2 rollouts",
    ]
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
    assert figure.legends[0].get_texts()[-1].get_text() == "the first 5 of 9 rollouts"


def test_without_rollouts_the_distributions_are_drawn_alone(draws: Draws) -> None:
    figure = draw(make_belief(draws), make_belief(draws), torch.zeros(0, 7, 4))
    assert len(figure.legends[0].get_texts()) == 3


def test_prediction_that_is_not_there_is_said_to_be_missing(draws: Draws, tmp_path: Path) -> None:
    belief = make_belief(draws)
    nothing = Gaussian(belief.mean * torch.nan, belief.cov * torch.nan)
    figure = draw(belief, nothing, draws.normal(2, 7, 4))
    assert figure.legends[0].get_texts()[2].get_text() == "no prediction"
    save_figure(figure, tmp_path / "figure.png")


@pytest.mark.parametrize("dim", range(1, 11))
def test_grid_of_panels_has_no_empty_place(dim: int) -> None:
    figure, panels = panels_of(dim, "time (s)")
    grid = panels[0].get_gridspec()
    assert grid.nrows * grid.ncols == dim == len(panels) == len(figure.axes)


@pytest.mark.parametrize("std", [1e-4, 1e3])
def test_the_demonstrated_band_stays_readable_beside_any_prediction(
    draws: Draws, std: float
) -> None:
    demonstrated = make_belief(draws)
    for entry, panel in enumerate(
        draw(demonstrated, make_belief(draws, std=std), draws.normal(2, 7, 4)).axes
    ):
        bottom, top = panel.get_ylim()
        seen = edges(demonstrated, entry)[..., 1]
        assert bottom < seen.min()
        assert seen.max() < top
        assert top - bottom < 20


def test_distributions_of_different_shapes_are_refused(draws: Draws) -> None:
    with pytest.raises(
        ValueError,
        match=r"predicted must be \(6, 4\), .* got \(5, 4\), \(3, 7, 4\) and \(2, 7, 4\)",
    ):
        draw(make_belief(draws), make_belief(draws, steps=5), draws.normal(2, 7, 4))


def test_a_prediction_with_a_graph_is_drawn(draws: Draws) -> None:
    belief = make_belief(draws)
    draw(belief, Gaussian(belief.mean.requires_grad_(), belief.cov), draws.normal(2, 7, 4))


def test_learning_curve_is_in_percent_seconds_and_nats() -> None:
    rates, divergences = plot_learning_curve(
        [2.5, 5.0, 7.5], [0.0, 0.5, 1.0], [np.nan, 1e3, 10.0]
    ).axes
    curves = [line for line in rates.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(curves[0].get_xydata(), [[2.5, 0], [5, 50], [7.5, 100]])
    np.testing.assert_array_equal(divergences.lines[0].get_ydata(), [np.nan, 1e3, 10])
    assert rates.get_ylim() == (0, 100)
    assert divergences.get_yscale() == "log"
    assert (rates.get_ylabel(), divergences.get_ylabel(), divergences.get_xlabel()) == (
        "success rate (%)",
        "predicted KL (nats)",
        "experience (s)",
    )
    assert [line.get_ydata() for line in rates.lines if line.get_linestyle() == ":"] == [[95, 95]]


def test_learning_curve_of_single_rollouts_has_points_that_failed_or_succeeded() -> None:
    upper = plot_learning_curve([2.5, 5.0], [0.0, 1.0], [9.0, 2.0], of_one_rollout=True).axes[0]
    (points,) = upper.lines
    assert points.get_linestyle() == "None"
    assert [label.get_text() for label in upper.get_yticklabels()] == ["failed", "succeeded"]


def test_learning_curve_of_another_loss_is_labelled_so() -> None:
    assert (
        plot_learning_curve([2.5], [0.0], [5.0], "predicted cost").axes[1].get_ylabel()
        == "predicted cost"
    )


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
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["no value"]
    save_figure(figure, tmp_path / "curve.png")


@pytest.mark.parametrize("loss", [2.0, np.nan])
def test_learning_curve_ends_with_the_saved_policy(loss: float, tmp_path: Path) -> None:
    figure = plot_learning_curve([2.5, 5.0], [0.0, 0.5], [9.0, 5.0], saved=(7.5, 1.0, loss))
    stars = [line.get_xydata() for panel in figure.axes for line in panel.lines[1:]]
    np.testing.assert_array_equal(stars[-2:], [[[7.5, 100]], [[7.5, loss]]])
    assert figure.axes[1].get_xlim()[1] > 7.5
    save_figure(figure, tmp_path / "curve.png")


@pytest.mark.parametrize(
    ("losses", "told"), [([40.0, 14.0], {"20", "30", "40"}), ([1000.0, 2.0], {"10", "100", "1000"})]
)
def test_loss_has_plain_numbers_on_its_axis(losses: list[float], told: set[str]) -> None:
    axis = plot_learning_curve([2.5, 5.0], [0.0, 0.5], losses).axes[1].yaxis
    labels = {axis.get_major_formatter()(at) for at in axis.get_majorticklocs()} | {
        axis.get_minor_formatter()(at) for at in axis.get_minorticklocs()
    }
    assert told <= labels and not any("e" in label or "$" in label for label in labels if label)


def test_bad_learning_curve_is_refused() -> None:
    with pytest.raises(ValueError, match="must be equally long, got 2, 1, 2"):
        plot_learning_curve([2.5, 5.0], [0.0], [1.0, 1.0])
    with pytest.raises(ValueError, match=r"success_rate must be between 0 and 1, got \[95.0\]"):
        plot_learning_curve([2.5], [95.0], [1.0])


def test_every_pose_is_drawn_from_the_base_in_its_colour() -> None:
    figure = plot_poses(swing(5), TIME_STEP)
    panel, colourbar = figure.axes
    poses = [line for line in panel.lines if len(line.get_xdata()) == 3]
    expected = torch.cat([torch.zeros(5, 2), swing(5)], -1).reshape(5, 3, 2)
    np.testing.assert_allclose([line.get_xydata() for line in poses], expected)
    assert len({line.get_color() for line in poses}) == 5
    assert panel.get_aspect() == 1
    assert (panel.get_xlabel(), panel.get_ylabel(), colourbar.get_ylabel()) == (
        "x (m)",
        "y (m)",
        "time (s)",
    )
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


def test_positions_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"positions must have shape \(N, 4\), got \(3, 2\)"):
        plot_poses(torch.zeros(3, 2), TIME_STEP)
    with pytest.raises(ValueError, match=r"positions must have shape \(N, 4\), got \(4,\)"):
        next(pendulum_frames(torch.zeros(4), TIME_STEP))


def test_figure_is_a_png_file_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "poses.png"
    path.write_text("old")
    save_figure(plot_poses(swing(3), TIME_STEP), path)
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert list(tmp_path.iterdir()) == [path]


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
    corners = panel.collections[0].get_paths()[0].vertices
    for edge in (lower, upper):
        distances = np.abs(corners[None] - np.stack([experience, 100 * edge], -1)[:, None]).max(-1)
        np.testing.assert_allclose(distances.min(1), 0, atol=1e-12)
    assert (panel.get_xlabel(), panel.get_ylabel(), panel.get_ylim()) == (
        "experience (s)",
        "success rate (%)",
        (0, 100),
    )


def test_success_over_experience_of_different_shapes_is_refused() -> None:
    with pytest.raises(
        ValueError,
        match=r"must be \(K,\) for rates \(runs, K\), got \(2,\), \(3,\), \(3,\) for \(1, 3\)",
    ):
        plot_success_over_experience(np.zeros(2), np.zeros((1, 3)), np.zeros(3), np.zeros(3))


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
        corners = band.get_paths()[0].vertices
        for edge in (mean - half, mean + half):
            distances = np.abs(corners[None] - np.stack([experience, 100 * edge], -1)[:, None]).max(
                -1
            )
            np.testing.assert_allclose(distances.min(1), 0, atol=1e-12)
    assert (
        drawn["a"].get_color() != drawn["b"].get_color()
        and drawn["a"].get_marker() != drawn["b"].get_marker()
    )
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]
    assert (panel.get_xlabel(), panel.get_ylabel(), panel.get_ylim()) == (
        "experience (s)",
        "success rate (%)",
        (0, 100),
    )
    save_figure(figure, tmp_path / "methods.png")


def test_method_with_curves_of_different_lengths_is_named() -> None:
    with pytest.raises(
        ValueError,
        match=r"experience, mean and interval of b must be equally long, got \[2, 3, 2, 2\]",
    ):
        plot_success_of_methods({"b": (np.zeros(2), np.zeros(3), np.zeros(2), np.zeros(2))})
