"""Figure of how well a policy does at each of many targets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat
from string import ascii_lowercase
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from torch_pmil.plotting.style import DARK, check_some, labelled

COLOURS = "viridis"  # readable for colour-blind readers, and in grey
PANEL_WIDTH = 2.8  # inches
LABEL_WIDTH = 22  # characters, beside a colour bar of that height


def plot_heat_map(
    x: Sequence[float] | np.ndarray,
    y: Sequence[float] | np.ndarray,
    maps: Mapping[str, tuple[np.ndarray, np.ndarray]],
    training_targets: np.ndarray,
    *,
    labels: tuple[str, str],
    value: str,
    picture: np.ndarray | None = None,
) -> Figure:
    """A value at each target of a regular grid as a filled cell, with the successes (Figure 11).

    The maps of several methods are side by side with one colour scale, which begins at 0.

    Args:
        x, y: coordinates of the grid, evenly spaced and increasing, (C,) and (R,).
        maps: by the title of their panel, the values (R, C), not negative, and whether the target
            was reached, (R, C), bool.
        training_targets: drawn as white discs with their convex hull, (S, 2).
        labels: labels of the two axes, with their units.
        value: label of the colour bar, with its unit.
        picture: picture of the set-up for the left, (height, width, 3), uint8; the panels are then
            lettered (a), (b), ...

    Raises:
        ValueError: the grid is not evenly spaced, or values, successes or targets have another
            shape or range.

    Example:
        >>> near = np.array([[0.1, 0.3], [0.2, 0.4]])
        >>> grid, labels = [0.0, 0.5], ("x (m)", "y (m)")
        >>> maps = {"ours": (near, near < 0.25)}
        >>> figure = plot_heat_map(
        ...     grid, grid, maps, np.zeros((1, 2)), labels=labels, value="distance (m)"
        ... )
        >>> figure.axes[0].get_title(loc="left")
        'ours'
    """
    x, y, training_targets = (np.asarray(a, dtype=float) for a in (x, y, training_targets))
    _check(x, y, maps, training_targets)
    columns = len(maps) + (picture is not None)
    aspect = _width(y) / _width(x)
    if picture is not None:
        aspect = max(aspect, 0.85 * picture.shape[0] / picture.shape[1])
    figsize = PANEL_WIDTH * columns + 1.4, PANEL_WIDTH * aspect + 1.0
    figure = Figure(figsize=figsize, layout="compressed")
    panels = list(figure.subplots(1, columns, squeeze=False)[0])
    letters: Iterator[str] = repeat("")
    if picture is not None:
        letters = map("({})".format, ascii_lowercase)
        left = panels.pop(0)
        left.imshow(picture)
        left.set(xticks=[], yticks=[])
        left.spines[:].set_visible(False)
        left.set_title(next(letters), loc="left")
    scale = Normalize(0.0, max(values.max() for values, _ in maps.values()))
    for panel, (title, (values, reached)) in zip(panels, maps.items(), strict=True):
        cells: dict[str, Any] = {"shading": "nearest", "edgecolors": "face", "linewidth": 0.1}
        panel.pcolormesh(x, y, values, cmap=COLOURS, norm=scale, **cells)
        _draw_training_targets(panel, training_targets)
        _draw_successes(panel, x, y, reached)
        panel.set(xlabel=labels[0], aspect="equal")
        panel.set_title(f"{next(letters)} {title}".strip(), loc="left")
    panels[0].set_ylabel(labels[1])
    for panel in panels[1:]:
        panel.tick_params(labelleft=False, left=False)
    colours = ScalarMappable(scale, COLOURS)
    figure.colorbar(colours, ax=panels, label=fill(value, LABEL_WIDTH), shrink=0.9)
    handles = labelled(panels[0])
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _width(places: np.ndarray) -> float:
    """Width of all cells together."""
    return (places[-1] - places[0]) * len(places) / (len(places) - 1)


def _draw_successes(panel: Axes, x: np.ndarray, y: np.ndarray, reached: np.ndarray) -> None:
    """Draw a dot at each grid point that was reached, (R, C), and a cross at the others."""
    across, up = np.meshgrid(x, y)
    kinds = (("o", 4.5, reached, "reached"), ("X", 6.5, ~reached, "missed"))
    for marker, size, chosen, label in kinds:
        look: dict[str, Any] = {"markersize": size, "mfc": DARK, "mec": "white", "mew": 0.8}
        panel.plot(across[chosen], up[chosen], marker, label=label, zorder=4, **look)


def _draw_training_targets(panel: Axes, targets: np.ndarray) -> None:
    """Draw white discs, larger than the marks of the grid, and their convex hull."""
    corners = _hull(targets)
    panel.plot(*corners, color=DARK, linewidth=3.0, zorder=2)
    panel.plot(*corners, color="white", linewidth=1.4, zorder=2)
    look: dict[str, Any] = {"markersize": 12, "mfc": "white", "mec": DARK, "mew": 1.0}
    panel.plot(*targets.T, "o", label="training target", zorder=3, **look)


def _hull(points: np.ndarray) -> np.ndarray:
    """The closed convex hull of points (S, 2), or both ends if they are on one line, (2, K)."""
    if np.linalg.matrix_rank(points - points[0]) < 2:
        return points[np.lexsort(points.T)][[0, -1]].T
    corners = ConvexHull(points).vertices
    return points[[*corners, corners[0]]].T


def _check(
    x: np.ndarray,
    y: np.ndarray,
    maps: Mapping[str, tuple[np.ndarray, np.ndarray]],
    training_targets: np.ndarray,
) -> None:
    for name, places in (("x", x), ("y", y)):
        steps = np.diff(places)
        increasing = places.ndim == 1 and len(steps) > 0 and (steps > 0).all()
        if not (increasing and np.allclose(steps, steps[0])):
            raise ValueError(
                f"{name} must be at least two increasing, evenly spaced coordinates, got "
                f"{places.tolist()}"
            )
    check_some("maps", maps)
    shape = (len(y), len(x))
    for title, (values, reached) in maps.items():
        if values.shape != shape or reached.shape != shape or reached.dtype != bool:
            raise ValueError(
                f"values and successes of {title} must be numbers and bools {shape}, got "
                f"{values.shape} and {reached.dtype} {reached.shape}"
            )
        allowed = np.isfinite(values) & (values >= 0)
        if not allowed.all():
            raise ValueError(
                f"values of {title} must be finite and not negative, got {values[~allowed][0]}"
            )
    if training_targets.ndim != 2 or training_targets.shape[1] != 2 or not len(training_targets):
        raise ValueError(f"training_targets must be (S, 2), got {training_targets.shape}")
