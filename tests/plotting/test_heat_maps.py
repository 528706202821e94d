"""The map of a value over a grid of targets: what is drawn where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torch_pmil.plotting import plot_heat_map, save_figure

X, Y = np.array([0.0, 0.1, 0.2, 0.3]), np.array([-0.7, -0.6, -0.5])
VALUES = np.arange(12.0).reshape(3, 4)
REACHED = VALUES % 3 == 0
# the last one is inside
TARGETS = np.array([[0.05, -0.65], [0.25, -0.65], [0.15, -0.55], [0.15, -0.62]])
MAPS = {"ours": (VALUES, REACHED)}
PICTURE = np.full((8, 12, 3), 100, dtype=np.uint8)


def draw(
    maps: dict = MAPS, targets: np.ndarray = TARGETS, picture: np.ndarray | None = None
) -> Figure:
    named = {"labels": ("x (m)", "y (m)"), "value": "distance (m)"}
    return plot_heat_map(X, Y, maps, targets, picture=picture, **named)


def points_of(panel: Axes, label: str) -> np.ndarray:
    (line,) = [line for line in panel.lines if line.get_label() == label]
    return line.get_xydata()


def test_each_cell_has_its_value_about_its_target() -> None:
    figure = draw()
    panel, bar = figure.axes
    (mesh,) = panel.collections
    corners = mesh.get_coordinates()
    middles = (corners[:-1, :-1] + corners[1:, 1:]) / 2
    np.testing.assert_allclose(middles, np.stack(np.meshgrid(X, Y), -1))
    np.testing.assert_array_equal(mesh.get_array(), VALUES)
    assert panel.get_aspect() == 1
    labels = panel.get_xlabel(), panel.get_ylabel(), bar.get_ylabel()
    assert labels == ("x (m)", "y (m)", "distance (m)")


def test_reached_and_missed_targets_have_marks_of_different_shapes() -> None:
    panel = draw().axes[0]
    places = np.stack(np.meshgrid(X, Y), -1)
    np.testing.assert_allclose(points_of(panel, "reached"), places[REACHED])
    np.testing.assert_allclose(points_of(panel, "missed"), places[~REACHED])
    shapes = {line.get_label(): line.get_marker() for line in panel.lines}
    assert shapes["reached"] != shapes["missed"]


@pytest.mark.parametrize(
    ("targets", "corners"),
    [
        (TARGETS, TARGETS[:3]),
        (TARGETS[:2], TARGETS[:2]),
        (TARGETS[:1], TARGETS[:1]),
        (TARGETS[[1, 0, 1]], TARGETS[:2]),
    ],
)
def test_training_targets_are_discs_and_their_hull_is_a_closed_line(
    targets: np.ndarray, corners: np.ndarray
) -> None:
    panel = draw(targets=targets).axes[0]
    np.testing.assert_array_equal(points_of(panel, "training target"), targets)
    for outline in panel.lines[:2]:
        drawn = outline.get_xydata()
        assert {tuple(corner) for corner in drawn} == {tuple(corner) for corner in corners}
        assert len(corners) < 3 or (drawn[0] == drawn[-1]).all()


def test_several_maps_share_one_colour_scale_from_zero() -> None:
    figure = draw({**MAPS, "nearest": (3 * VALUES, REACHED)})
    *panels, _ = figure.axes
    assert [panel.get_title(loc="left") for panel in panels] == ["ours", "nearest"]
    assert [panel.collections[0].get_clim() for panel in panels] == [(0, 33), (0, 33)]


def test_picture_is_on_the_left_and_the_panels_are_lettered(tmp_path: Path) -> None:
    figure = draw({**MAPS, "nearest": (VALUES, REACHED)}, picture=PICTURE)
    *panels, _ = figure.axes
    assert (panels[0].images[0].get_array() == PICTURE).all()
    assert [panel.get_title(loc="left")[:3] for panel in panels] == ["(a)", "(b)", "(c)"]
    save_figure(figure, tmp_path / "map.png")


def test_map_on_which_all_is_zero_and_reached_is_drawn(tmp_path: Path) -> None:
    save_figure(draw({"ours": (0 * VALUES, REACHED | True)}), tmp_path / "map.png")
