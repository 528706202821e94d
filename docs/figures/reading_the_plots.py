"""Draw the pictures of docs/how_to/reading_the_plots.md: figures of a run after two trials,
and of the same run when it has learned.

Learns both into runs/reading_the_plots first, in three minutes; a run that is there is not learned
again.

Example:
    python docs/figures/reading_the_plots.py
"""

from __future__ import annotations

import io
from pathlib import Path

import torch
from PIL import Image

from torch_pmil import load_experiment
from torch_pmil.files import replacing
from torch_pmil.plotting import Figure
from torch_pmil.runs.figures import figures_of
from torch_pmil.runs.training import train

SEED = 0
TRIALS = {"early": 2, "learned": 12}
SHOWN = {
    "early": ("trajectories", "kl_per_step", "calibration"),
    "learned": (
        "trajectories",
        "learning_curve",
        "kl_per_step",
        "calibration",
        "model",
        "policy",
        "poses",
    ),
}
DPI, COLOURS = 110, 128
RUNS, FOLDER = Path("runs/reading_the_plots"), Path(__file__).parent


def save_small(figure: Figure, path: Path) -> None:
    """As a PNG file of few colours."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    with replacing(path) as temporary:
        Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
            temporary, optimize=True
        )


def main() -> None:
    """Learn, draw and save."""
    torch.set_num_threads(1)
    experiment = load_experiment("double_pendulum")
    for name, trials in TRIALS.items():
        result = train(
            experiment,
            SEED,
            trials,
            RUNS / name,
            "python docs/figures/reading_the_plots.py",
            resume=True,
        )
        for kind, figure in figures_of(experiment, result):
            if kind in SHOWN[name]:
                save_small(figure, FOLDER / f"plots_{kind}_{name}.png")


if __name__ == "__main__":
    main()
