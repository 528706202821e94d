"""Figure of the terms of a KL divergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting.style import BLUE, COLOURS, HATCHES, VERMILLION, WIDTH, style
from torch_pmil.search.kl import gaussian_kl_terms


def plot_kl_per_step(
    names: Sequence[str], time_step: float, demonstrated: Gaussian, predicted: Gaussian
) -> Figure:
    """The KL divergence of each time step, stacked by its terms (Eq. 20).

    The heights of the stacks sum to the KL of the trajectory. The upper panel separates different
    means from different covariances, the lower one the entries of the match space. Each entry is
    conditioned on those before it (:func:`~torch_pmil.search.kl.gaussian_kl_terms`).

    Args:
        names: names of the M entries of the match space.
        time_step: seconds between two samples; the first one shown is t = 1.
        demonstrated: demonstrated marginals at t = 1..T, mean (T, M), with observation noise.
        predicted: predicted marginals of the same shape, with the same noise.

    Raises:
        ValueError: shapes do not fit each other.
        NotPositiveDefiniteError: a covariance has no Cholesky factor.

    Example:
        >>> import torch
        >>> belief = Gaussian(torch.zeros(5, 2), torch.eye(2).expand(5, 2, 2))
        >>> shifted = Gaussian(belief.mean + 1, belief.cov)
        >>> figure = plot_kl_per_step(("q", "dq"), 0.1, belief, shifted)
        >>> figure.axes[0].get_title(loc="left")
        'KL of the trajectory: 5.0 nats'
    """
    shape = demonstrated.mean.shape
    if len(shape) != 2 or predicted.mean.shape != shape or shape[1] != len(names):
        raise ValueError(
            f"demonstrated and predicted must be (T, {len(names)}) for {len(names)} names, "
            f"got {tuple(shape)} and {tuple(predicted.mean.shape)}"
        )
    terms = gaussian_kl_terms(demonstrated.detach(), predicted.detach())
    mean, spread = (term.numpy() for term in terms)  # (T, M)
    time = time_step * np.arange(1, len(mean) + 1)
    figure = Figure(figsize=(WIDTH, 4.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    by_kind = {"means differ": mean.sum(1), "spreads differ": spread.sum(1)}
    by_entry = dict(zip(names, (mean + spread).T, strict=True))
    _draw_stack(upper, time, by_kind, (VERMILLION, BLUE))
    _draw_stack(lower, time, by_entry, COLOURS, "given those below")
    total = (mean + spread).sum()
    upper.set_title(f"KL of the trajectory: {total:.1f} nats", loc="left", fontsize="medium")
    lower.set_xlabel("time (s)")
    return figure


def _draw_stack(
    panel: Axes,
    time: np.ndarray,
    parts: Mapping[str, np.ndarray],
    colours: Sequence[str],
    heading: str = "",
) -> None:
    """Draw bars at every multiple of the first time, one part on the other."""
    style(panel)
    below, width = np.zeros_like(time), 0.85 * time[0]
    for index, (name, heights) in enumerate(parts.items()):
        look: dict[str, Any] = {"edgecolor": "white", "linewidth": 0.4, "label": name}
        look["color"] = colours[index % len(colours)]
        look["hatch"] = HATCHES[index // len(colours) % len(HATCHES)]
        panel.bar(time, heights, width, bottom=below, **look)
        below = below + heights
    panel.set(ylabel="KL (nats)", xlim=(time[0] / 2, time[-1] + time[0] / 2))
    beside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1, 1), "frameon": False}
    panel.legend(title=heading, alignment="left", reverse=True, **beside)
