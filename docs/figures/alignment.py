"""Draw the picture of docs/how_to/demonstrations.md: swing-ups with artificial timing,
before and after their alignment.

Example:
    python docs/figures/alignment.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from scipy.interpolate import CubicSpline, PchipInterpolator

from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.demonstrations.preparation.alignment import align
from torch_pmil.plotting import BLUE, Figure, save_figure
from torch_pmil.plotting.style import style

STEP = 0.01  # s
PACES = 0.04  # standard deviation of the moments, as a fraction of the duration


def shown_by_people(seed: int) -> list[torch.Tensor]:
    """The shipped swing-ups at 100 Hz, each at a pace of its own."""
    draws, shown, shipped = (
        np.random.default_rng(seed),
        [],
        shipped_demonstrations("double_pendulum"),
    )
    for positions in shipped.positions.numpy():
        steps = round(shipped.duration / STEP * draws.uniform(0.85, 1.15))
        moments = np.linspace(0, 1, 6)
        pace = PchipInterpolator(
            moments, np.sort(moments + np.r_[0, PACES * draws.normal(size=4), 0])
        )
        motion = CubicSpline(np.linspace(0, 1, len(positions)), positions)
        shown.append(torch.from_numpy(motion(pace(np.linspace(0, 1, steps + 1)))))
    return shown


def main() -> None:
    """Draw and save."""
    shown = shown_by_people(seed=0)
    aligned = align(shown)
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (title, trajectories) in enumerate({"as shown": shown, "aligned": aligned}.items()):
        panels[0, column].set_title(title)
        panels[1, column].set_xlabel("time (s)")
        for row, name in ((0, "x2"), (1, "y2")):
            style(panels[row, column])
            panels[row, 0].set_ylabel(f"{name} (m)")
            for trajectory in trajectories:
                time = STEP * np.arange(len(trajectory))
                panels[row, column].plot(
                    time, trajectory[:, 2 + row], color=BLUE, linewidth=1.0, alpha=0.8
                )
    save_figure(figure, Path(__file__).with_suffix(".png"))


if __name__ == "__main__":
    main()
