"""Figures of series of pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from torch_pmil.plotting.style import check_some

HEIGHT = 2.4  # inches, of a picture


def plot_photo_series(rows: Mapping[str, Sequence[np.ndarray]], times: Sequence[float]) -> Figure:
    """Pictures of several motions below each other, at the same times (Figure 8).

    Args:
        rows: K pictures (height, width, 3) of each motion, uint8, by its name.
        times: times of the columns, (K,), s.

    Raises:
        ValueError: a row has another number of pictures.

    Example:
        >>> pictures = [np.zeros((8, 8, 3), dtype=np.uint8)] * 2
        >>> figure = plot_photo_series({"shown": pictures, "learned": pictures}, (0.0, 0.5))
        >>> len(figure.axes)
        4
    """
    for name, pictures in rows.items():
        if len(pictures) != len(times):
            raise ValueError(
                f"{name} must have a picture for each of the {len(times)} times, got "
                f"{len(pictures)}"
            )
    check_some("rows", rows)
    height, width, _ = next(iter(rows.values()))[0].shape
    size = HEIGHT * width / height * len(times) + 0.3, HEIGHT * len(rows) + 0.5
    figure = Figure(figsize=size, layout="compressed")
    panels = figure.subplots(len(rows), len(times), squeeze=False)
    for line, (name, pictures) in zip(panels, rows.items(), strict=True):
        line[0].set_ylabel(name)
        for panel, picture in zip(line, pictures, strict=True):
            panel.imshow(picture)
            panel.set(xticks=[], yticks=[])
            panel.spines[:].set_visible(False)
    for panel, time in zip(panels[0], times, strict=True):
        panel.set_title(f"{time:.2f} s", fontsize="medium")
    return figure
