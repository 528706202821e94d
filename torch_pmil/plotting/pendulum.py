"""Figures and pictures of a robot drawn as a chain of lines."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from torch import Tensor

from torch_pmil.plotting.style import BLUE, DARK, GREY, ORANGE, style

# colours of times, without the faintest yellow
LATE_IS_DARK = ListedColormap(mpl.colormaps["viridis_r"](np.linspace(0.12, 1, 256)))
ROOM = 1.15  # half the side of a picture of the pendulum, in lengths of the stretched pendulum
TRAIL = 25  # frames of the tip's past that an animation shows


def plot_poses(joints: Tensor, time_step: float) -> Figure:
    """Poses of a robot during one rollout, coloured by time (Figure 5).

    Args:
        joints: places in m, from the base to the tip, (T + 1, P, 2), from t = 0.
        time_step: seconds between two poses.

    Raises:
        ValueError: the joints have another shape.

    Example:
        >>> import torch
        >>> joints = torch.tensor([[[0.0, 0.0], [0.0, -0.5]], [[0.0, 0.0], [0.0, 0.5]]])
        >>> plot_poses(joints, 0.1).axes[0].get_xlabel()
        'x (m)'
    """
    poses = _checked(joints)
    reach = _reach(poses)
    colours = ScalarMappable(Normalize(0, time_step * (len(poses) - 1)), LATE_IS_DARK)
    figure = Figure(figsize=(6.0, 4.6), layout="compressed")
    panel = figure.subplots()
    times = time_step * np.arange(len(poses))
    for pose, colour in zip(poses, map(tuple, colours.to_rgba(times)), strict=True):
        panel.plot(
            *pose.T, color=colour, linewidth=2.2, solid_capstyle="round", marker="o", markersize=3.5
        )
    panel.plot(0, 0, color=DARK, marker="o", markersize=8)
    panel.set(
        xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x (m)", ylabel="y (m)"
    )
    style(panel)
    figure.colorbar(colours, ax=panel, label="time (s)")
    return figure


def pendulum_frames(joints: Tensor, time_step: float, size: int = 480) -> Iterator[np.ndarray]:
    """Pictures of a moving robot, drawn without OpenGL.

    Args:
        joints: places in m, from the base to the tip, (N, P, 2), a pose for each picture.
        time_step: seconds between two pictures, for the clock in the corner.
        size: height and width of a picture.

    Yields:
        N pictures (size, size, 3), uint8.

    Raises:
        ValueError: the joints have another shape.

    Example:
        >>> import torch
        >>> joints = torch.tensor([[[0.0, 0.0], [0.0, -0.5], [0.0, -1.0]]])
        >>> frame = next(pendulum_frames(joints, 0.02, size=64))
        >>> frame.shape
        (64, 64, 3)
    """
    poses = _checked(joints)
    canvas, panel = _stage(size, _reach(poses))
    trail = panel.plot([], [], color=ORANGE, linewidth=0.9, alpha=0.5)[0]
    links = [
        panel.plot([], [], color=(BLUE, ORANGE)[link % 2], linewidth=2.4, solid_capstyle="round")[0]
        for link in range(poses.shape[1] - 1)
    ]
    disc: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 2.2, "markeredgewidth": 0}
    hubs = panel.plot([], [], color=DARK, **disc)[0]
    corner: dict[str, Any] = {"transform": panel.transAxes, "va": "top"}
    clock = panel.text(0.04, 0.95, "", fontsize=3.2, color=GREY, **corner)
    for number, pose in enumerate(poses):
        trail.set_data(*poses[max(0, number - TRAIL) : number + 1, -1].T)
        for first, link in enumerate(links):
            link.set_data(*pose[first : first + 2].T)
        hubs.set_data(*pose[:-1].T)
        clock.set_text(f"{number * time_step:.1f} s")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _checked(joints: Tensor) -> np.ndarray:
    """Joints (N, P, 2) relative to the base in the first pose."""
    if joints.ndim != 3 or joints.shape[2] != 2 or not joints.numel():
        raise ValueError(f"joints must have shape (N, P, 2), got {tuple(joints.shape)}")
    return (joints - joints[:1, :1]).detach().numpy()


def _reach(joints: np.ndarray) -> float:
    """Half the side of a square in which every pose lies."""
    return ROOM * np.linalg.norm(joints, axis=-1).max()


def _stage(size: int, reach: float) -> tuple[FigureCanvasAgg, Axes]:
    """A canvas of size x size pixels with the circle that the tip can reach.

    The figure is one inch wide, so that line widths, in points, are seventy-seconds of the picture
    whatever its size.
    """
    figure = Figure(figsize=(1, 1), dpi=size, facecolor="#F4F7FA")
    canvas = FigureCanvasAgg(figure)
    panel = figure.add_axes((0, 0, 1, 1), xlim=(-reach, reach), ylim=(-reach, reach))
    panel.set_axis_off()
    look: dict[str, Any] = {"facecolor": "white", "edgecolor": "#D5DCE3", "linewidth": 0.2}
    panel.add_patch(Circle((0, 0), reach / ROOM, **look))
    return canvas, panel
