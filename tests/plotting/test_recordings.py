"""Recordings drawn: every demonstration in every panel, and paths in the plane of x and y."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from torch_pmil.plotting import plot_recordings


def drawn(
    count: int, names: tuple[str, ...], units: tuple[str, ...] = ()
) -> tuple[Figure, list[torch.Tensor], list[torch.Tensor]]:
    generator = torch.Generator().manual_seed(0)
    times = [5 + 0.1 * torch.arange(10 + number, dtype=torch.float64) for number in range(count)]
    values = [torch.randn(len(time), len(names), generator=generator).double() for time in times]
    labels = [str(number) for number in range(count)]
    return plot_recordings(labels, times, values, names, units), times, values


def test_every_demonstration_is_in_every_panel_from_time_0() -> None:
    figure, times, values = drawn(3, ("q", "dq"))
    for column, panel in enumerate(figure.axes):
        for line, time, value in zip(panel.lines, times, values, strict=True):
            np.testing.assert_allclose(line.get_xdata(), time - 5)
            assert np.array_equal(line.get_ydata(), value[:, column])


def test_pairs_x_and_y_have_their_plane_with_starts_and_ends() -> None:
    figure, _, values = drawn(2, ("x1", "y1", "q", "x2", "y2"), ("m", "m", "rad", "m", "m"))
    for plane, (x, y) in zip(figure.axes[5:], ((0, 1), (3, 4)), strict=True):
        number = 1 + x // 3
        assert (plane.get_xlabel(), plane.get_ylabel()) == (f"x{number} (m)", f"y{number} (m)")
        assert plane.get_aspect() == 1
        parts = [part for value in values for part in (value, value[:1], value[-1:])]
        for line, part in zip(plane.lines, parts, strict=True):
            assert np.array_equal(line.get_xydata(), part[:, [x, y]])
        assert [text.get_text() for text in plane.get_legend().get_texts()] == ["start", "end"]


@pytest.mark.parametrize("names", [("x",), ("y", "z"), ("q", "dq", "xray")])
def test_other_entries_have_no_plane(names: tuple[str, ...]) -> None:
    assert len(drawn(2, names)[0].axes) == len(names)


def test_demonstrations_look_different_while_they_can() -> None:
    lines = drawn(15, ("q",))[0].axes[0].lines
    looks = {
        (line.get_color(), str(line.get_linestyle()), str(line._unscaled_dash_pattern))
        for line in lines
    }
    assert len(looks) == 15
    many, _, _ = drawn(16, ("q",))
    assert len({line.get_color() for line in many.axes[0].lines}) == 1 and not many.legends


@pytest.mark.parametrize("count", [3, 9, 15])
def test_legend_is_no_wider_than_the_figure_and_panels_do_not_overlap(count: int) -> None:
    figure, _, _ = drawn(count, ("x", "y"), ("m", "m"))
    figure.draw_without_rendering()
    box, frame = figure.legends[0].get_window_extent(), figure.bbox
    assert frame.x0 <= box.x0 and box.x1 <= frame.x1 and box.y1 <= frame.y1
    assert not any(panel.get_window_extent().overlaps(box) for panel in figure.axes)
    assert not any(
        one.get_tightbbox().overlaps(other.get_tightbbox()) for one, other in pairwise(figure.axes)
    )
