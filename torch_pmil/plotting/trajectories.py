"""Figures of trajectory distributions over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.control.state_space import with_unit
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting.style import (
    BAND,
    BLUE,
    DARK,
    FEW,
    GREY,
    VERMILLION,
    Band,
    band_of,
    check_some,
    draw_band,
    legend_above,
    panels_over_time,
    rollouts_of,
)

# how far a prediction may stretch a panel, in heights of the demonstrated and executed motion
OVERSHOOT = 0.75
SHOWN = 20  # number of particles that are drawn one by one
DASHED = (0, (4, 2))
EXECUTED: dict[str, Any] = {"color": DARK, "linewidth": 0.9, "linestyle": DASHED}


def plot_distributions(
    names: Sequence[str],
    units: Sequence[str],
    time_step: float,
    demonstrations: Tensor | None,
    demonstrated: Gaussian | None,
    predicted: Gaussian,
    executed: Tensor,
) -> Figure:
    """Demonstrated and predicted trajectory distribution with executed rollouts (Figure 6).

    There is one panel for each entry. The demonstrated distribution is a filled band, the predicted
    one an outline around its mean; both reach two standard deviations from the mean. A prediction
    far beyond the demonstrated and executed motion leaves the panel, so that the motion stays
    readable. A prediction that is not finite is not drawn.

    Args:
        names, units: those of the M entries of the match space.
        time_step: seconds between two samples.
        demonstrations: N demonstrations at t = 0..T, (N, T + 1, M); None if there are none.
        demonstrated: demonstrated marginals at t = 1..T, or None.
        predicted: predicted marginals at t = 1..T, mean (T, M) and cov (T, M, M).
        executed: rollouts of the robot at t = 0..T, (B, T + 1, M), NaN after the end of one that
            was cut short; the first 5 are drawn.

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> import torch
        >>> belief = Gaussian(torch.zeros(5, 2), torch.eye(2).expand(5, 2, 2))
        >>> shown, executed = torch.zeros(2, 6, 2), torch.ones(9, 6, 2)
        >>> named = "ab", ("rad", "m")
        >>> figure = plot_distributions(*named, 0.1, shown, belief, belief, executed)
        >>> [panel.get_ylabel() for panel in figure.axes]
        ['a (rad)', 'b (m)']
        >>> figure.legends[0].get_texts()[-1].get_text()
        'the first 5 of 9 rollouts'
    """
    marginals = predicted if demonstrated is None else demonstrated
    shown = executed[:0] if demonstrations is None else demonstrations
    check_some("demonstrated.mean", marginals.mean)
    T, M = marginals.mean.shape
    paths = shown.shape[1:] == executed.shape[1:] == (T + 1, M)
    if not (predicted.mean.shape == (T, M) and paths and len(names) == len(units) == M):
        raise ValueError(
            f"predicted must be {(T, M)}, demonstrations and executed (N, {T + 1}, {M}) for "
            f"demonstrated marginals {(T, M)}, with a name and a unit for each entry, got "
            f"{tuple(predicted.mean.shape)}, {tuple(shown.shape)} and "
            f"{tuple(executed.shape)}, {len(names)} names and {len(units)} units"
        )
    time = time_step * np.arange(T + 1)
    figure, panels = panels_over_time(list(map(with_unit, names, units)))
    for entry, panel in enumerate(panels):
        given, done = (each[..., entry].detach().numpy() for each in (shown, executed[:FEW]))
        prediction, drawn = band_of(predicted, entry), [*given, *done]
        if demonstrated is not None:
            band = band_of(demonstrated, entry)
            draw_band(panel, time[1:], band, BLUE, f"demonstrated ± {BAND} std")
            drawn += [*band]
        _draw_paths(panel, time, given, {"color": BLUE, "linewidth": 0.6}, "demonstrations")
        _draw_outline(panel, time[1:], prediction)
        _draw_paths(panel, time, done, EXECUTED, rollouts_of(len(executed)))
        panel.set_ylim(*_limits(np.concatenate(drawn), np.concatenate(prediction)))
    legend_above(figure, 4, panels[0])
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
        names, units: those of the M entries of the match space.
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
    figure, panels = panels_over_time(list(map(with_unit, names, units)))
    for entry, panel in enumerate(panels):
        band = band_of(demonstrated, entry)
        draw_band(panel, time[1:], band, VERMILLION, f"estimated ± {BAND} std")
        drawn = demonstrations[..., entry].numpy().T
        lines = panel.plot(time, drawn, color=BLUE, linewidth=1.0, linestyle=DASHED)
        lines[0].set_label("demonstrations")
    legend_above(figure, 2, panels[0])
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
        names, units: those of the D entries.
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
    figure, panels = panels_over_time(list(map(with_unit, names, units)))
    for entry, panel in enumerate(panels):
        drawn = particles[..., entry].detach().numpy()
        mean, reach = drawn.mean(0), BAND * drawn.std(0, ddof=1)
        band = band_of(predicted, entry)
        draw_band(panel, time, band, VERMILLION, f"moment matching ± {BAND} std")
        edges = np.stack([mean - reach, mean, mean + reach], -1)
        lines = panel.plot(time, edges, color=DARK, linewidth=1.0, linestyle=DASHED, zorder=3)
        lines[-1].set_label(f"particles: mean ± {BAND} std")
        single = panel.plot(time, drawn[:SHOWN].T, color=GREY, linewidth=0.4, alpha=0.6)
        single[0].set_label("some particles")
    legend_above(figure, 3, panels[0])
    return figure


def _draw_paths(
    panel: Axes, time: np.ndarray, paths: np.ndarray, look: Mapping[str, Any], label: str
) -> None:
    """Draw paths (N, T + 1), if there are any, with one label."""
    lines = panel.plot(time, paths.T, **look)
    for line in lines[:1]:
        line.set_label(label)


def _draw_outline(panel: Axes, time: np.ndarray, band: Band) -> None:
    """Draw both edges of a band and, thinner, its mean."""
    there = np.isfinite(band).all()
    for edge, width in zip(band, (1.3, 0.6, 1.3), strict=True):
        lines = panel.plot(time, edge, color=VERMILLION, linewidth=width)
    lines[0].set_label(f"predicted ± {BAND} std" if there else "no prediction")


def _limits(shown: np.ndarray, prediction: np.ndarray) -> tuple[float, float]:
    """Ends of an axis that shows all of ``shown``, and as much prediction as OVERSHOOT allows."""
    low, high = np.nanmin(shown), np.nanmax(shown)
    overshoot, margin = OVERSHOOT * (high - low), 0.05 * (high - low)
    there = np.isfinite(prediction)
    lowest = max(prediction.min(initial=low, where=there), low - overshoot)
    highest = min(prediction.max(initial=high, where=there), high + overshoot)
    return lowest - margin, highest + margin
