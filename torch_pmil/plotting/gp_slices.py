"""Slices through a fitted model: each output over each input."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.control.state_space import with_unit
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.plotting.style import (
    BAND,
    DARK,
    GREY,
    VERMILLION,
    WIDTH,
    legend_above,
    style,
)

POINTS = 200  # of each slice
BEYOND = 0.15  # how far a slice goes beyond the data, as a fraction of their range


def draw_uncertainty(panel: Axes, x: np.ndarray, mean: np.ndarray, std: np.ndarray) -> None:
    """Draw how uncertain a GP is, in grey."""
    look: dict[str, Any] = {"color": GREY, "alpha": 0.25, "linewidth": 0}
    panel.fill_between(x, mean - BAND * std, mean + BAND * std, label=f"± {BAND} std", **look)


@torch.no_grad()
def plot_gp_slices(
    dynamics: ForwardModel,
    point: Tensor,
    input_names: Sequence[str],
    output_names: Sequence[str],
    output_units: Sequence[str],
    over: Sequence[int] | None = None,
) -> Figure:
    """Each output of a model over each of its inputs, the other inputs held at a point.

    There is a row for each output and a column for each input, with the mean and two standard
    deviations of the next observation, noise included. The dots are partial residuals: a datum at
    its own input, as far above the mean as its residual. Their opacity is the correlation that the
    model sees between them and the slice: faint data have other inputs that are far from the point.

    Args:
        dynamics: a model that is fitted to data.
        point: the point where the slices meet, (D' + F,), in the units of the inputs.
        input_names: names of the D' + F inputs.
        output_names: names of the E entries of the state that are learned.
        output_units: their units.
        over: inputs that have a column; all if None.

    Raises:
        ValueError: point or names do not fit the model, or ``over`` names an input that it does not
            have.
        RuntimeError: the model has no data.

    Example:
        >>> x = torch.linspace(-2, 2, 20, dtype=torch.float64)[:, None]
        >>> from torch_pmil import GPDynamics
        >>> dynamics = GPDynamics(num_inputs=1, num_outputs=1)
        >>> fit = dynamics.fit(x, x.sin())
        >>> figure = plot_gp_slices(dynamics, torch.zeros(1), ["u (N·m)"], ["q"], ["rad"])
        >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
        ('u (N·m)', 'change of\\nq (rad)')
    """
    over = range(dynamics.num_inputs) if over is None else over
    _check(dynamics, point, input_names, output_names, output_units, over)
    figure = Figure(figsize=(WIDTH, 0.8 + 1.5 * dynamics.num_outputs), layout="constrained")
    shape = dynamics.num_outputs, len(over)
    panels = figure.subplots(*shape, sharex="col", sharey="row", squeeze=False)
    what = "change of" if dynamics.targets.matrix.any() else "next"
    for column, entry in zip(panels.T, over, strict=True):
        column[-1].set_xlabel(input_names[entry])
        for output, panel in enumerate(column):
            _draw_slice(panel, dynamics, point.double(), entry, output)
    for row, name, unit in zip(panels, output_names, output_units, strict=True):
        row[0].set_ylabel(f"{what}\n{with_unit(name, unit)}")
    figure.align_ylabels(panels[:, 0])
    legend_above(figure, 4, panels[0, 0])
    return figure


def _draw_slice(
    panel: Axes, dynamics: ForwardModel, point: Tensor, entry: int, output: int
) -> None:
    """Draw one output over one input."""
    style(panel)
    grid = _grid(dynamics.train_inputs[:, entry])
    mean, variance = dynamics.predict(_along(point, entry, grid))
    x, centre = grid.numpy(), mean[:, output].numpy()
    std = (variance + dynamics.noise)[:, output].sqrt().numpy()
    draw_uncertainty(panel, x, centre, std)
    panel.plot(x, centre, color=DARK, linewidth=1.4, label="mean", zorder=3)
    dotted: dict[str, Any] = {"color": VERMILLION, "linewidth": 0.8, "linestyle": ":"}
    panel.axvline(point[entry].item(), label="where the slices meet", **dotted)
    panel.margins(x=0)
    _draw_data(panel, dynamics, point, entry, output)


def _draw_data(panel: Axes, dynamics: ForwardModel, point: Tensor, entry: int, output: int) -> None:
    """Draw partial residuals, as opaque as the model correlates the data with the slice."""
    inputs, targets = dynamics.train_inputs, dynamics.train_targets
    others = torch.arange(dynamics.num_inputs) != entry
    distance = ((inputs - point) / dynamics.lengthscales[output])[:, others]
    nearness = distance.square().sum(-1).div(-2).exp()
    residuals = (
        targets - dynamics.mean(inputs) + dynamics.mean(_along(point, entry, inputs[:, entry]))
    )
    look: dict[str, Any] = {"alpha": nearness.numpy(), "color": VERMILLION, "linewidth": 0}
    look["label"] = "data, fainter if far from the slice"
    panel.scatter(inputs[:, entry], residuals[:, output], s=9, zorder=4, **look)


def _along(point: Tensor, entry: int, values: Tensor) -> Tensor:
    """The point with other values (K,) of one input, (K, D' + F)."""
    inputs = point.repeat(len(values), 1)
    inputs[:, entry] = values
    return inputs


def _grid(data: Tensor) -> Tensor:
    """Evenly spaced values from below the least of the data to above the largest."""
    low, high = data.aminmax()
    margin = BEYOND * (high - low).item()
    return torch.linspace(low.item() - margin, high.item() + margin, POINTS, dtype=torch.float64)


def _check(
    dynamics: ForwardModel,
    point: Tensor,
    input_names: Sequence[str],
    output_names: Sequence[str],
    output_units: Sequence[str],
    over: Sequence[int],
) -> None:
    dynamics.check_has_data()
    inputs, outputs = dynamics.num_inputs, dynamics.num_outputs
    fits_inputs = point.shape == (inputs,) and len(input_names) == inputs
    if not (fits_inputs and len(output_names) == len(output_units) == outputs):
        raise ValueError(
            f"point and input_names must have {inputs} entries, output_names and output_units "
            f"{outputs}, got {tuple(point.shape)}, {len(input_names)}, {len(output_names)} and "
            f"{len(output_units)}"
        )
    if not over or not set(over) <= set(range(inputs)):
        raise ValueError(f"over must be inputs from 0 to {inputs - 1}, got {list(over)}")
