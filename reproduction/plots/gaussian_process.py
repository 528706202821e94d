"""Figures of a Gaussian process of one input and one output (Figures 2 and 4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting.gp_slices import draw_uncertainty
from torch_pmil.plotting.style import (
    BLUE,
    DARK,
    GREY,
    VERMILLION,
    labelled,
    legend_above,
    style,
)

BINS = 120
INPUT, OUTPUT = "state and action $\\tilde{x}_t$", "next state $x_{t+1}$"


def plot_gp(
    inputs: Tensor, targets: Tensor, grid: Tensor, posterior: Gaussian, test_input: float
) -> Figure:
    """A GP with its data and its uncertainty, and a test input away from the data (Figure 2).

    Args:
        inputs, targets: inputs and targets of the data, (n,) each.
        grid: inputs at which the posterior is drawn, (K,).
        posterior: posterior at the grid, mean (K, 1) and cov (K, 1, 1).
        test_input: an input that is marked by a line.

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> posterior = Gaussian(torch.zeros(3, 1), torch.ones(3, 1, 1))
        >>> figure = plot_gp(torch.zeros(1), torch.zeros(1), torch.arange(3), posterior, 2.0)
        >>> [text.get_text() for text in figure.legends[0].get_texts()]
        ['mean', '± 2 std', 'data', 'test input']
    """
    if inputs.shape != targets.shape:
        raise ValueError(
            f"inputs and targets must be (n,) each, got {tuple(inputs.shape)} and "
            f"{tuple(targets.shape)}"
        )
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    panel = figure.subplots()
    _draw_posterior(panel, grid, posterior)
    panel.plot(inputs.numpy(), targets.numpy(), "x", color=DARK, markersize=6, label="data")
    panel.axvline(test_input, color=VERMILLION, linewidth=1.6, label="test input")
    panel.set(xlabel=INPUT, ylabel=OUTPUT)
    legend_above(figure, 4, panel)
    return figure


def plot_moment_matching(
    grid: Tensor, posterior: Gaussian, belief: Gaussian, samples: Tensor, matched: Gaussian
) -> Figure:
    """Exact output distribution of a GP at a Gaussian input, and its moment matching (Figure 4).

    The exact distribution is a histogram; the Gaussian beside it has the same moments.

    Args:
        grid: inputs at which the posterior is drawn, (K,).
        posterior: posterior at the grid, mean (K, 1) and cov (K, 1, 1).
        belief: belief over the input, mean (1,) and cov (1, 1).
        samples: samples of the output at that uncertain input, (S,).
        matched: belief over the output by moment matching, mean (1,) and cov (1, 1).

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> one = Gaussian(torch.zeros(1), torch.ones(1, 1))
        >>> posterior = Gaussian(torch.zeros(3, 1), torch.ones(3, 1, 1))
        >>> grid, samples = torch.linspace(-3, 3, 3), torch.linspace(-2, 2, 9)
        >>> figure = plot_moment_matching(grid, posterior, one, samples, one)
        >>> [text.get_text() for text in figure.axes[-1].get_legend().get_texts()]
        ['mean', '± 2 std', 'exact, by sampling', 'moment matching', 'input']
    """
    if not (belief.mean.shape == matched.mean.shape == (1,) and samples.ndim == 1):
        raise ValueError(
            "belief and matched must be of one entry and samples (S,), got "
            f"{tuple(belief.mean.shape)}, {tuple(matched.mean.shape)} and {tuple(samples.shape)}"
        )
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    shares: dict[str, Any] = {"sharex": "col", "sharey": "row"}
    panels = figure.subplots(2, 2, width_ratios=(2, 1), height_ratios=(2, 1), **shares)
    (function, output), (source, corner) = panels
    corner.set_axis_off()
    _draw_posterior(function, grid, posterior)
    mean, reach = matched.mean.item(), 3 * matched.std.item()
    heights = np.linspace(mean - reach, mean + reach, 400)
    bars: dict[str, Any] = {"density": True, "orientation": "horizontal", "color": VERMILLION}
    output.hist(samples.numpy(), BINS, alpha=0.35, label="exact, by sampling", **bars)
    density = _density(matched, heights)
    output.plot(density, heights, color=BLUE, linewidth=1.8, label="moment matching")
    points = grid.numpy()
    area: dict[str, Any] = {"color": DARK, "alpha": 0.3, "linewidth": 0}
    source.fill_between(points, _density(belief, points), label="input", **area)
    output.tick_params(labelbottom=True)
    output.set(xlabel="density")
    output.set_xlim(left=0)
    function.set(ylabel=OUTPUT)
    source.set(xlabel=INPUT, ylabel="density")
    source.set_ylim(bottom=0)
    for panel in (output, source):
        style(panel)
    corner.legend(handles=labelled(function, output, source), loc="center", frameon=False)
    return figure


def _draw_posterior(panel: Axes, grid: Tensor, posterior: Gaussian) -> None:
    """Draw mean and band of a GP over its input."""
    if posterior.mean.shape != (len(grid), 1):
        raise ValueError(
            f"posterior must have a mean of shape {(len(grid), 1)}, a row for a point of the grid, "
            f"got {tuple(posterior.mean.shape)}"
        )
    points, mean, std = grid.numpy(), posterior.mean[:, 0].numpy(), posterior.std[:, 0].numpy()
    panel.plot(points, mean, color=GREY, linewidth=1.4, label="mean")
    draw_uncertainty(panel, points, mean, std)
    panel.set_xlim(points[0], points[-1])
    style(panel)


def _density(belief: Gaussian, points: np.ndarray) -> np.ndarray:
    """Density of a belief over one entry, at points (K,)."""
    mean, std = belief.mean.item(), belief.std.item()
    return np.exp(-(((points - mean) / std) ** 2) / 2) / (std * np.sqrt(2 * np.pi))
