"""A series of pictures has each picture at its place."""

from __future__ import annotations

import numpy as np
import pytest

from torch_pmil.plotting import plot_photo_series


def picture(shade: int) -> np.ndarray:
    return np.full((8, 8, 3), shade, dtype=np.uint8)


def test_each_picture_is_in_its_row_and_below_its_time() -> None:
    figure = plot_photo_series(
        {"shown": [picture(0), picture(50)], "learned": [picture(100), picture(150)]}, (0.0, 1.25)
    )
    shades = [panel.images[0].get_array()[0, 0, 0] for panel in figure.axes]
    assert shades == [0, 50, 100, 150]
    assert [panel.get_title() for panel in figure.axes[:2]] == ["0.00 s", "1.25 s"]
    assert [panel.get_ylabel() for panel in figure.axes[::2]] == ["shown", "learned"]


def test_missing_picture_is_refused() -> None:
    with pytest.raises(
        ValueError, match="learned must have a picture for each of the 2 times, got 1"
    ):
        plot_photo_series({"shown": [picture(0)] * 2, "learned": [picture(0)]}, (0.0, 1.0))
