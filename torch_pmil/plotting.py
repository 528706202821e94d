"""Figures of the results: distributions, learning curve, poses. The only file that imports matplotlib."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from torch import Tensor

from torch_pmil.files import replacing
from torch_pmil.gaussian import Gaussian

# Okabe and Ito's colours, which colour-blind readers can tell apart
BLUE, VERMILLION, ORANGE, GREY = "#0072B2", "#D55E00", "#E69F00", "#555555"
DARK = "#1A1A1A"
LATE_IS_DARK = ListedColormap(mpl.colormaps["viridis_r"](np.linspace(0.12, 1, 256)))  # without the faintest yellow
BAND = 2  # standard deviations on either side of the mean
OVERSHOOT = 0.75  # how far a prediction may stretch a panel, in heights of the demonstrated and executed motion
ROOM = 1.15  # half the side of a picture of the pendulum, in lengths of the stretched pendulum
TRAIL = 25  # frames of the tip's past that an animation shows


def plot_distributions(
    names: Sequence[str], units: Sequence[str], time_step: float, expert: Gaussian, predicted: Gaussian, executed: Tensor
) -> Figure:
    """Demonstrated and predicted trajectory distribution with executed rollouts, one panel an entry (Figure 6).

    Bands are two standard deviations on either side of the mean. A predicted band that goes far beyond the
    demonstrated and executed motion leaves the panel, so that the motion stays readable.

    Args:
        names: of the M entries of the match space.
        units: of those entries.
        time_step: seconds between two samples; the first one shown is t = 1.
        expert: demonstrated marginals at t = 1..T, mean (T, M) and cov (T, M, M).
        predicted: predicted marginals of the same shape.
        executed: rollouts of the robot at t = 1..T, (B, T, M).

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> belief = Gaussian(torch.zeros(5, 2), torch.eye(2).expand(5, 2, 2))
        >>> figure = plot_distributions(("q", "dq"), ("rad", "rad/s"), 0.1, belief, belief, torch.zeros(3, 5, 2))
        >>> [panel.get_ylabel() for panel in figure.axes]
        ['q (rad)', 'dq (rad/s)']
    """
    shape = expert.mean.shape
    if not (len(names) == len(units) == shape[-1] and predicted.mean.shape == shape == executed.shape[1:]):
        raise ValueError(
            f"predicted and executed must be (T, M) and (B, T, M) for an expert {tuple(shape)} and {len(names)} names with "
            f"{len(units)} units, got {tuple(predicted.mean.shape)} and {tuple(executed.shape)}"
        )
    time = time_step * np.arange(1, shape[0] + 1)
    figure, panels = _panels(len(names), "time (s)")
    for entry, panel in enumerate(panels):
        rollouts = executed[..., entry].detach().numpy()
        demonstrated, prediction = _band(expert, entry), _band(predicted, entry)
        _draw_band(panel, time, demonstrated, BLUE, f"demonstrated ± {BAND} std")
        _draw_band(panel, time, prediction, VERMILLION, f"predicted ± {BAND} std")
        lines = panel.plot(time, rollouts.T, color=DARK, linewidth=0.7, linestyle=(0, (4, 2)), alpha=0.8)
        if lines:
            lines[0].set_label("executed")
        panel.set_ylim(*_limits(np.concatenate([*demonstrated, *rollouts]), np.concatenate(prediction)))
        panel.set_ylabel(f"{names[entry]} ({units[entry]})")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def plot_learning_curve(
    experience_s: Sequence[float], success_rate: Sequence[float], loss: Sequence[float], label: str = "KL (nats)"
) -> Figure:
    """Success rate (Figure 7) and predicted loss after each trial, over the robot's experience.

    Args:
        experience_s: seconds of motion the robot had learned from, (N,).
        success_rate: fractions from 0 to 1, (N,); drawn in percent, with the paper's 95 % as a dotted line.
        loss: predicted loss over the trajectory, (N,), on a logarithmic axis; a value that is NaN, or not positive, is left out.
        label: names it, with its unit.

    Raises:
        ValueError: the lengths differ, or a success rate is outside 0 to 1.

    Example:
        >>> figure = plot_learning_curve([2.5, 5.0], [0.0, 0.9], [4e3, 20.0])
        >>> figure.axes[1].get_xlabel(), figure.axes[1].get_ylabel()
        ('experience (s)', 'predicted KL (nats)')
    """
    if not len(experience_s) == len(success_rate) == len(loss):
        lengths = len(experience_s), len(success_rate), len(loss)
        raise ValueError("experience_s, success_rate and loss must be equally long, got {}, {}, {}".format(*lengths))
    percent = 100 * np.asarray(success_rate, dtype=float)
    if not ((percent >= 0) & (percent <= 100)).all():
        raise ValueError(f"success_rate must be between 0 and 1, got {list(success_rate)}")
    loss = np.asarray(loss, dtype=float)
    figure = Figure(figsize=(6.0, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    _success_axis(upper)
    upper.plot(experience_s, percent, color=BLUE, marker="o", markersize=4, clip_on=False, zorder=3)
    lower.plot(experience_s, np.where(loss > 0, loss, np.nan), color=VERMILLION, marker="s", markersize=4, zorder=3)
    lower.set(yscale="log", xlabel="experience (s)", ylabel=f"predicted {label}")
    lower.set_xlim(left=0)
    for panel in (upper, lower):
        style(panel)
    return figure


def plot_success_over_experience(experience_s: np.ndarray, rates: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Figure:
    """Mean success rate over runs with its 95 % interval, and each run's own as a thin line (Figure 7).

    Args:
        experience_s: seconds of motion the robot had learned from, (K,).
        rates: fractions from 0 to 1, (runs, K); drawn in percent, with the paper's 95 % as a dotted line.
        lower: end of the interval of the mean, a fraction, (K,).
        upper: the other end.

    Raises:
        ValueError: the shapes do not fit each other.

    Example:
        >>> figure = plot_success_over_experience(np.array([2.5, 5.0]), np.array([[0.0, 1.0]]), np.zeros(2), np.ones(2))
        >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
        ('experience (s)', 'success rate (%)')
    """
    if not experience_s.shape == lower.shape == upper.shape == rates.shape[1:]:
        raise ValueError(
            f"experience_s, lower and upper must be (K,) for rates (runs, K), got {experience_s.shape}, {lower.shape}, {upper.shape} "
            f"for {rates.shape}"
        )
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    panel = figure.subplots()
    _success_axis(panel)
    runs = panel.plot(experience_s, 100 * rates.T, color=GREY, linewidth=0.7, alpha=0.5, clip_on=False)
    runs[0].set_label("single runs")
    band = {"facecolor": (BLUE, 0.2), "edgecolor": (BLUE, 0.6), "linewidth": 0.8}
    panel.fill_between(experience_s, 100 * lower, 100 * upper, label="95 % interval of the mean", **band)
    mean = 100 * rates.mean(0)
    panel.plot(experience_s, mean, color=BLUE, marker="o", markersize=4, clip_on=False, zorder=3, label=f"mean of {len(rates)} runs")
    panel.set(xlabel="experience (s)")
    panel.set_xlim(left=0)
    style(panel)
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def plot_poses(positions: Tensor, time_step: float) -> Figure:
    """The poses of a double pendulum during one rollout, coloured by time (Figure 5).

    Args:
        positions: link ends [x1, y1, x2, y2] in m, (T + 1, 4), from t = 0; the base is at the origin.
        time_step: seconds between two poses.

    Raises:
        ValueError: the positions have another shape.

    Example:
        >>> import torch
        >>> plot_poses(torch.tensor([[0.0, -0.5, 0.0, -1.0], [0.0, 0.5, 0.0, 1.0]]), 0.1).axes[0].get_xlabel()
        'x (m)'
    """
    joints = _joints(positions)
    reach = _reach(joints)
    colours = ScalarMappable(Normalize(0, time_step * (len(joints) - 1)), LATE_IS_DARK)
    figure = Figure(figsize=(5.4, 4.6), layout="constrained")
    panel = figure.subplots()
    for step, pose in enumerate(joints):
        panel.plot(*pose.T, color=colours.to_rgba(time_step * step), linewidth=2.2, solid_capstyle="round", marker="o", markersize=3.5)
    panel.plot(0, 0, color=DARK, marker="o", markersize=8)
    panel.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    style(panel)
    figure.colorbar(colours, ax=panel, label="time (s)")
    return figure


def pendulum_frames(positions: Tensor, time_step: float, size: int = 480) -> Iterator[np.ndarray]:
    """Pictures of a moving double pendulum, drawn without OpenGL.

    Args:
        positions: link ends [x1, y1, x2, y2] in m, (N, 4), one row a picture; the base is at the origin.
        time_step: seconds between two pictures, for the clock in the corner.
        size: height and width of a picture.

    Yields:
        N pictures (size, size, 3), uint8.

    Raises:
        ValueError: the positions have another shape.

    Example:
        >>> import torch
        >>> frame = next(pendulum_frames(torch.tensor([[0.0, -0.5, 0.0, -1.0]]), 0.02, size=64))
        >>> frame.shape
        (64, 64, 3)
    """
    joints = _joints(positions)
    canvas, panel = _stage(size, _reach(joints))
    trail = panel.plot([], [], color=ORANGE, linewidth=0.9, alpha=0.5)[0]
    links = [panel.plot([], [], color=colour, linewidth=2.4, solid_capstyle="round")[0] for colour in (BLUE, ORANGE)]
    hubs = panel.plot([], [], color=DARK, linestyle="", marker="o", markersize=2.2, markeredgewidth=0)[0]
    clock = panel.text(0.04, 0.95, "", transform=panel.transAxes, fontsize=3.2, color=GREY, va="top")
    for number, pose in enumerate(joints):
        trail.set_data(*joints[max(0, number - TRAIL) : number + 1, 2].T)
        for link, ends in zip(links, (pose[:2], pose[1:]), strict=True):
            link.set_data(*ends.T)
        hubs.set_data(*pose[:2].T)
        clock.set_text(f"{number * time_step:.1f} s")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure as a PNG file with 150 dots per inch, wholly or not at all.

    Args:
        figure: what a function of this module returned.
        path: of the file; one that is there is replaced.

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


def _panels(count: int, xlabel: str) -> tuple[Figure, list[Axes]]:
    """A nearly square grid of ``count`` panels with one time axis; the lowest in each column is labelled."""
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(1.2 + 3.4 * columns, 0.8 + 2.2 * rows), layout="constrained")
    panels = [figure.add_subplot(rows, columns, index + 1) for index in range(count)]
    for index, panel in enumerate(panels):
        style(panel)
        panel.margins(x=0)
        if index + columns < count:
            panel.tick_params(labelbottom=False)
        else:
            panel.set_xlabel(xlabel)
    figure.align_ylabels(panels)
    return figure, panels


def style(panel: Axes) -> None:
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="0.92", linewidth=0.6)
    panel.set_axisbelow(True)


def _success_axis(panel: Axes) -> None:
    """An axis of success rates, with the paper's 95 %."""
    panel.axhline(95, color=GREY, linewidth=0.8, linestyle=":")
    panel.text(1.01, 95, "95 %", transform=panel.get_yaxis_transform(), fontsize=8, color=GREY, va="center")
    panel.set(ylim=(0, 100), ylabel="success rate (%)")
    panel.set_yticks([0, 25, 50, 75, 100])


def _band(belief: Gaussian, entry: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower edge, mean and upper edge of one entry, (T,) each."""
    mean, std = (moment[:, entry].detach().numpy() for moment in (belief.mean, belief.std))
    return mean - BAND * std, mean, mean + BAND * std


def _draw_band(panel: Axes, time: np.ndarray, band: tuple[np.ndarray, np.ndarray, np.ndarray], colour: str, label: str) -> None:
    lower, mean, upper = band
    panel.fill_between(time, lower, upper, facecolor=(colour, 0.25), edgecolor=(colour, 0.8), linewidth=0.8, label=label)
    panel.plot(time, mean, color=colour, linewidth=1.4)


def _limits(shown: np.ndarray, prediction: np.ndarray) -> tuple[float, float]:
    """Ends of an axis on which all of ``shown`` is seen, and the prediction as far as OVERSHOOT allows."""
    low, high = shown.min(), shown.max()
    overshoot, margin = OVERSHOOT * (high - low), 0.05 * (high - low)
    lowest = np.clip(prediction.min(), low - overshoot, low)
    highest = np.clip(prediction.max(), high, high + overshoot)
    return lowest - margin, highest + margin


def _joints(positions: Tensor) -> np.ndarray:
    """Base, elbow and tip (N, 3, 2) of link ends (N, 4)."""
    if positions.ndim != 2 or positions.shape[1] != 4:
        raise ValueError(f"positions must have shape (N, 4), got {tuple(positions.shape)}")
    ends = positions.detach().numpy().reshape(-1, 2, 2)
    return np.concatenate([np.zeros_like(ends[:, :1]), ends], axis=1)


def _reach(joints: np.ndarray) -> float:
    """Half the side of a square in which every pose lies."""
    return ROOM * np.linalg.norm(joints, axis=-1).max()


def _stage(size: int, reach: float) -> tuple[FigureCanvasAgg, Axes]:
    """A canvas of size x size pixels with the circle that the tip can reach.

    The figure is one inch wide, so that line widths, in points, are seventy-seconds of the picture whatever its size.
    """
    figure = Figure(figsize=(1, 1), dpi=size, facecolor="#F4F7FA")
    canvas = FigureCanvasAgg(figure)
    panel = figure.add_axes((0, 0, 1, 1), xlim=(-reach, reach), ylim=(-reach, reach))
    panel.set_axis_off()
    panel.add_patch(Circle((0, 0), reach / ROOM, facecolor="white", edgecolor="#D5DCE3", linewidth=0.2))
    return canvas, panel
