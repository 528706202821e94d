"""Common parts of all figures: colours, axes, bands, legends, and how figures are saved."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.layout_engine import ConstrainedLayoutEngine

from torch_pmil.files import replacing
from torch_pmil.gp.gaussian import Gaussian

# Okabe and Ito's colours, which colour-blind readers can tell apart
BLUE, VERMILLION, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#E69F00", "#009E73", "#555555"
SKY, PURPLE = "#56B4E9", "#CC79A7"  # of the same palette
DARK = "#1A1A1A"
COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE)  # of parts, which hatches tell apart too
HATCHES = (None, "///", "...", "xxx")
SERIES = tuple(zip((*COLOURS, DARK), "os^DvpX", strict=True))  # colours and markers
WIDTH = 8.0  # inches, of all figures of a run
MOST_COLUMNS = 3  # of panels
FEW = 5  # number of rollouts that are drawn one by one
BAND = 2  # standard deviations on either side of the mean

Band = tuple[np.ndarray, np.ndarray, np.ndarray]  # lower edge, mean and upper edge, (T,) each


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure as a PNG file with 150 dots per inch, wholly or not at all.

    Args:
        figure: the figure to write.
        path: the file to write; an existing file is replaced.

    Raises:
        OSError: the folder is missing or not writable.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "empty.png"
        >>> save_figure(Figure(), path)
        >>> path.read_bytes()[:4]
        b'\\x89PNG'
    """
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)


def save_picture(picture: np.ndarray, path: Path | str) -> None:
    """Write a picture (height, width, 3), uint8, as a PNG file, wholly or not at all.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "black.png"
        >>> save_picture(np.zeros((16, 16, 3), dtype=np.uint8), path)
        >>> path.read_bytes()[:4]
        b'\\x89PNG'
    """
    with replacing(path) as temporary:
        imsave(temporary, picture, format="png")


def style(panel: Axes) -> None:
    """Draw a panel without its upper and right edge, on a faint grid."""
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="0.92", linewidth=0.6)
    panel.set_axisbelow(True)


def labelled(*panels: Axes) -> list[Artist]:
    """Everything in the panels that has a label."""
    return [drawn for panel in panels for drawn in panel.get_legend_handles_labels()[0]]


def legend_above(figure: Figure, columns: int, *panels: Axes) -> None:
    """Draw one legend for these panels above the figure, unless nothing in them has a label."""
    if handles := labelled(*panels):
        figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False)


def check_some(name: str, items: Sized) -> None:
    """Raise ValueError if there is nothing to draw."""
    if not len(items):
        raise ValueError(f"{name} must hold one at least, got none")


def panels_over_time(labels: Sequence[str]) -> tuple[Figure, list[Axes]]:
    """A grid with a panel for each label and no empty place."""
    count = len(labels)
    columns = max(n for n in range(1, MOST_COLUMNS + 1) if count % n == 0)
    rows = count // columns
    figure = Figure(figsize=(WIDTH, 0.8 + 2.2 * rows), layout=ConstrainedLayoutEngine(w_pad=0.08))
    panels = [figure.add_subplot(rows, columns, index + 1) for index in range(count)]
    label_over_time(figure, panels, labels, columns)
    return figure, panels


def label_over_time(
    figure: Figure, panels: Sequence[Axes], labels: Sequence[str], columns: int
) -> None:
    """Style the panels of a grid; only the lowest one in each column has a time axis."""
    for index, (panel, label) in enumerate(zip(panels, labels, strict=True)):
        style(panel)
        panel.margins(x=0)
        panel.set_ylabel(label)
        if index + columns < len(panels):
            panel.tick_params(labelbottom=False)
        else:
            panel.set_xlabel("time (s)")
    figure.align_ylabels(panels)


def rollouts_of(count: int) -> str:
    """Label of the rollouts that are drawn.

    Example:
        >>> rollouts_of(20), rollouts_of(3), rollouts_of(1)
        ('the first 5 of 20 rollouts', 'all 3 rollouts', 'the rollout')
    """
    if count == 1:
        return "the rollout"
    return f"the first {FEW} of {count} rollouts" if count > FEW else f"all {count} rollouts"


def band_of(belief: Gaussian, entry: int) -> Band:
    """The band of one entry."""
    mean, std = (moment[:, entry].detach().numpy() for moment in (belief.mean, belief.std))
    return mean - BAND * std, mean, mean + BAND * std


def draw_band(panel: Axes, x: np.ndarray, band: Band, colour: str, label: str) -> None:
    """Draw a band with its edges, and its mean."""
    lower, mean, upper = band
    look: dict[str, Any] = {"facecolor": (colour, 0.25), "edgecolor": (colour, 0.8)}
    panel.fill_between(x, lower, upper, linewidth=0.8, label=label, **look)
    panel.plot(x, mean, color=colour, linewidth=1.4)
