"""Figures of trajectory distributions over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting.style import (
    BAND,
    BLUE,
    DARK,
    GREY,
    VERMILLION,
    band_of,
    check_some,
    draw_band,
    panels_of,
)

# how far a prediction may stretch a panel, in heights of the demonstrated and executed motion
OVERSHOOT = 0.75
SHOWN = 20  # number of particles that are drawn one by one


def plot_distributions(
    names: Sequence[str],
    units: Sequence[str],
    time_step: float,
    demonstrated: Gaussian,
    predicted: Gaussian,
    executed: Tensor,
) -> Figure:
    """Demonstrated and predicted trajectory distribution with executed rollouts (Figure 6).

    There is one panel for each entry.

    Bands are two standard deviations on either side of the mean. A predicted band that goes far
    beyond the demonstrated and executed motion leaves the panel, so that the motion stays readable.

    Args:
        names: names of the M entries of the match space.
        units: units of the M entries.
        time_step: seconds between two samples; the first one shown is t = 1.
        demonstrated: demonstrated marginals at t = 1..T, mean (T, M) and cov (T, M, M).
        predicted: predicted marginals of the same shape.
        executed: rollouts of the robot at t = 1..T, (B, T, M).

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> belief = Gaussian(torch.zeros(5, 2), torch.eye(2).expand(5, 2, 2))
        >>> names, units, executed = ("q", "dq"), ("rad", "rad/s"), torch.zeros(3, 5, 2)
        >>> figure = plot_distributions(names, units, 0.1, belief, belief, executed)
        >>> [panel.get_ylabel() for panel in figure.axes]
        ['q (rad)', 'dq (rad/s)']
    """
    shape = demonstrated.mean.shape
    named = len(names) == len(units) == shape[-1]
    if not (named and predicted.mean.shape == shape == executed.shape[1:] and shape.numel()):
        raise ValueError(
            "predicted and executed must be (T, M) and (B, T, M) for demonstrated marginals "
            f"{tuple(shape)} and {len(names)} names with {len(units)} units, got "
            f"{tuple(predicted.mean.shape)} and {tuple(executed.shape)}"
        )
    time = time_step * np.arange(1, shape[0] + 1)
    figure, panels = panels_of(len(names), "time (s)")
    for entry, panel in enumerate(panels):
        rollouts = executed[..., entry].detach().numpy()
        shown, prediction = band_of(demonstrated, entry), band_of(predicted, entry)
        draw_band(panel, time, shown, BLUE, f"demonstrated ± {BAND} std")
        draw_band(panel, time, prediction, VERMILLION, f"predicted ± {BAND} std")
        lines = panel.plot(
            time, rollouts.T, color=DARK, linewidth=0.7, linestyle=(0, (4, 2)), alpha=0.8
        )
        if lines:
            lines[0].set_label("executed")
        panel.set_ylim(*_limits(np.concatenate([*shown, *rollouts]), np.concatenate(prediction)))
        panel.set_ylabel(f"{names[entry]} ({units[entry]})")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False
    )
    return figure


def plot_demonstrations(
    names: Sequence[str],
    units: Sequence[str],
    time_step: float,
    demonstrations: Tensor,
    demonstrated: Gaussian,
) -> Figure:
    """Demonstrations and the Gaussian trajectory distribution estimated from them (Figure 3).

    There is one panel for each entry.

    Args:
        names: names of the M entries of the match space.
        units: units of the M entries.
        time_step: seconds between two samples.
        demonstrations: N demonstrations at t = 0..T, (N, T + 1, M).
        demonstrated: marginals at t = 1..T, mean (T, M) and cov (T, M, M).

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> demonstrated = Gaussian(torch.zeros(5, 1), torch.ones(5, 1, 1))
        >>> shown = torch.zeros(3, 6, 1)
        >>> figure = plot_demonstrations(("x",), ("m",), 0.1, shown, demonstrated)
        >>> figure.axes[0].get_ylabel()
        'x (m)'
    """
    steps, entries = demonstrated.mean.shape
    if demonstrations.shape[1:] != (steps + 1, entries) or not len(names) == len(units) == entries:
        raise ValueError(
            f"demonstrations must be (N, {steps + 1}, {entries}) for demonstrated marginals "
            f"{(steps, entries)}, with a name and a unit for each entry, got "
            f"{tuple(demonstrations.shape)}, {len(names)} names and {len(units)} units"
        )
    check_some("demonstrations", demonstrations)
    time = time_step * np.arange(steps + 1)
    figure, panels = panels_of(entries, "time (s)")
    for entry, panel in enumerate(panels):
        band = band_of(demonstrated, entry)
        draw_band(panel, time[1:], band, VERMILLION, f"estimated ± {BAND} std")
        drawn = demonstrations[..., entry].numpy().T
        lines = panel.plot(time, drawn, color=BLUE, linewidth=1.0, linestyle=(0, (4, 2)))
        lines[0].set_label("demonstrations")
        panel.set_ylabel(f"{names[entry]} ({units[entry]})")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False
    )
    return figure


def plot_prediction(
    names: Sequence[str],
    units: Sequence[str],
    time_step: float,
    predicted: Gaussian,
    particles: Tensor,
) -> Figure:
    """A predicted trajectory distribution beside particles of the same policy and model.

    There is one panel for each entry.

    Args:
        names: names of the D entries.
        units: units of the D entries.
        time_step: seconds between two samples; the first one shown is t = 1.
        predicted: marginals at t = 1..T by moment matching, mean (T, D) and cov (T, D, D).
        particles: trajectories of :func:`~torch_pmil.model.particles.sample_trajectories`, (N, T,
            D); the first 20 are drawn as lines.

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> predicted = Gaussian(torch.zeros(5, 1), torch.ones(5, 1, 1))
        >>> figure = plot_prediction(("q",), ("rad",), 0.1, predicted, torch.randn(100, 5, 1))
        >>> [text.get_text() for text in figure.legends[0].get_texts()]
        ['moment matching ± 2 std', 'particles: mean ± 2 std', 'some particles']
    """
    shape = predicted.mean.shape
    named = len(names) == len(units) == shape[-1]
    if not (named and particles.shape[1:] == shape and len(particles) > 1):
        raise ValueError(
            f"particles must be (N, {', '.join(map(str, shape))}) with N of at least 2 for a "
            f"prediction {tuple(shape)}, with a name and a unit for each entry, got "
            f"{tuple(particles.shape)}, {len(names)} names and {len(units)} units"
        )
    time = time_step * np.arange(1, shape[0] + 1)
    figure, panels = panels_of(len(names), "time (s)")
    for entry, panel in enumerate(panels):
        drawn = particles[..., entry].detach().numpy()
        mean, reach = drawn.mean(0), BAND * drawn.std(0, ddof=1)
        band = band_of(predicted, entry)
        draw_band(panel, time, band, VERMILLION, f"moment matching ± {BAND} std")
        dashed: dict[str, Any] = {"linewidth": 1.0, "linestyle": (0, (4, 2)), "zorder": 3}
        for edge in (mean - reach, mean, mean + reach):
            line = panel.plot(time, edge, color=DARK, **dashed)
        line[0].set_label(f"particles: mean ± {BAND} std")
        single = panel.plot(time, drawn[:SHOWN].T, color=GREY, linewidth=0.4, alpha=0.6)
        single[0].set_label("some particles")
        panel.set_ylabel(f"{names[entry]} ({units[entry]})")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False
    )
    return figure


def _limits(shown: np.ndarray, prediction: np.ndarray) -> tuple[float, float]:
    """Ends of an axis on which all of ``shown`` is seen, and much of the prediction.

    The prediction is seen as far as OVERSHOOT allows.
    """
    low, high = shown.min(), shown.max()
    overshoot, margin = OVERSHOOT * (high - low), 0.05 * (high - low)
    lowest = np.clip(prediction.min(), low - overshoot, low)
    highest = np.clip(prediction.max(), high, high + overshoot)
    return lowest - margin, highest + margin
