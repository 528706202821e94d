"""Figure of what a servo does alone at each of its gains, beside what learning took."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from torch_pmil.plotting.style import DARK

COLOURS = "Blues"


def plot_gains(
    stiffnesses: Sequence[float],
    dampings: Sequence[float],
    alone: np.ndarray,
    learned: Mapping[tuple[float, float], float],
) -> Figure:
    """Success rate of servos alone at each pair of gains, and the experience that learning took.

    Args:
        stiffnesses: C of them, N·m/rad.
        dampings: R of them, N·m·s/rad.
        alone: success rates, fractions from 0 to 1, (R, C).
        learned: experience to success (s) at some pairs of stiffness and damping; infinite where
            learning did not succeed.

    Raises:
        ValueError: the rates do not fit the numbers of gains.

    Example:
        >>> figure = plot_gains([3.0, 10.0], [1.0], np.array([[0.0, 1.0]]), {(3.0, 1.0): 7.5})
        >>> [text.get_text() for text in figure.axes[0].texts]
        ['0 %\\nlearned: 7.5 s', '100 %']
    """
    if alone.shape != (len(dampings), len(stiffnesses)):
        raise ValueError(
            f"alone must be ({len(dampings)}, {len(stiffnesses)}) for {len(dampings)} dampings and "
            f"{len(stiffnesses)} stiffnesses, got {alone.shape}"
        )
    figure = Figure(
        figsize=(1.5 * len(stiffnesses) + 1.8, 0.8 * len(dampings) + 0.9), layout="constrained"
    )
    panel, scale = figure.subplots(), Normalize(0, 100)
    panel.pcolormesh(100 * alone, cmap=COLOURS, norm=scale, edgecolors="white", linewidth=2)
    for row, damping in enumerate(dampings):
        for column, stiffness in enumerate(stiffnesses):
            lines = [f"{100 * alone[row, column]:.0f} %"]
            if (stiffness, damping) in learned:
                lines.append(_in_words(learned[stiffness, damping]))
            colour = "white" if alone[row, column] > 0.5 else DARK
            place = column + 0.5, row + 0.5
            panel.text(*place, "\n".join(lines), color=colour, ha="center", va="center", fontsize=9)
    panel.set_xticks(np.arange(len(stiffnesses)) + 0.5, [f"{gain:g}" for gain in stiffnesses])
    panel.set_yticks(np.arange(len(dampings)) + 0.5, [f"{gain:g}" for gain in dampings])
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    panel.set(xlabel="stiffness (N·m/rad)", ylabel="damping (N·m·s/rad)")
    figure.colorbar(
        ScalarMappable(scale, COLOURS), ax=panel, label="success rate of\nthe servos alone (%)"
    )
    return figure


def _in_words(experience_s: float) -> str:
    return f"learned: {experience_s:g} s" if math.isfinite(experience_s) else "not learned"
