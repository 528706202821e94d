"""Draw the pictures of docs/how_to/demonstrations.md: what each step makes of strokes that a camera
tracked, with jumps, noise and pixels.

The strokes are drawn at random, an arc of 0.8 s at 60 pictures a second; no recording is needed.
Also the three steps' figures in numbers.

Example:
    python docs/figures/conditioning.py
"""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

from torch_pmil.demonstrations.preparation.alignment import align, crop, resample
from torch_pmil.demonstrations.preparation.camera import plane_coordinates
from torch_pmil.demonstrations.preparation.jumps import without_jumps
from torch_pmil.demonstrations.preparation.smoothing import smooth, velocities
from torch_pmil.plotting import plot_before_after, save_figure

RATE, STROKES, NOISE, FASTEST, PERIOD, STEP = (
    60.0,
    5,
    2.0,
    3.0,
    0.15,
    0.1,
)  # Hz, -, pixels, m/s, s, s
SCALE = 1500.0  # pixels in a metre
MARKERS = torch.tensor(
    [[300.0, 1000.0], [1500.0, 1000.0], [1500.0, 250.0], [300.0, 250.0]], dtype=torch.float64
)
PLACES = torch.tensor([[0.0, 0.0], [0.8, 0.0], [0.8, 0.5], [0.0, 0.5]], dtype=torch.float64)  # m
NAMES, UNITS = ("x", "y"), ("m", "m")
FOLDER = Path(__file__).parent
Timed = tuple[Tensor, Tensor]


def tracked(draws: torch.Generator) -> tuple[Timed, Timed]:
    """A stroke as a camera saw it, in pixels, and its places and velocities as they were, in m and
    m/s, (T, 4).
    """
    rest, duration, height = (
        torch.rand(3, generator=draws).double() * torch.tensor([0.2, 0.3, 0.06])
    ).tolist()
    times = torch.arange(0, 0.3 + rest + 0.8 + duration + 0.2, 1 / RATE, dtype=torch.float64)
    s = ((times - 0.1 - rest) / (0.8 + duration)).clamp(0, 1)
    phase, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * (s * (1 - s)) ** 2 / (0.8 + duration)
    angle, speed = math.pi * phase, math.pi * rate
    motion = torch.stack([0.4 - 0.3 * angle.cos(), 0.1 + (0.25 + height) * angle.sin()], -1)
    moving = torch.stack([0.3 * angle.sin() * speed, (0.25 + height) * angle.cos() * speed], -1)
    pixels = torch.stack([300 + SCALE * motion[:, 0], 1000 - SCALE * motion[:, 1]], -1)
    pixels += NOISE * torch.randn(pixels.shape, generator=draws).double()
    first = int(torch.randint(10, len(times) - 20, (1,), generator=draws))
    pixels[first : first + 3] = torch.tensor(
        [1600.0, 300.0]
    ).double()  # something else that looks alike
    return (times, pixels), (times, torch.cat([motion, moving], -1))


def main() -> None:
    """Draw and save, and print the errors that are left."""
    draws = torch.Generator().manual_seed(0)
    seen, truth = zip(*(tracked(draws) for _ in range(STROKES)), strict=True)
    metres = [(times, plane_coordinates(pixels, MARKERS, PLACES)) for times, pixels in seen]
    kept = [without_jumps(values, times, FASTEST)[::-1] for times, values in metres]
    smoothed = [
        (times, torch.cat([smooth(values, times, PERIOD), velocities(values, times, PERIOD)], -1))
        for times, values in kept
    ]
    cropped = [
        crop(resample(values, times, 1 / RATE), velocities=(2, 3)) for times, values in smoothed
    ]
    aligned = align(cropped, velocities=(2, 3))
    shown = aligned[..., :2]
    base = torch.arange(aligned.shape[1], dtype=torch.float64) / RATE
    at_control_rate = resample(shown, base, STEP)
    control = STEP * torch.arange(at_control_rate.shape[1], dtype=torch.float64)
    uncropped = [(times, values[:, :2]) for times, values in smoothed]
    unaligned = [(torch.arange(len(one)) / RATE, one[:, :2]) for one in cropped]
    both, units = (*NAMES, "dx", "dy"), (*UNITS, "m/s", "m/s")
    pictures = {
        "jumps": plot_before_after(NAMES, UNITS, metres, kept, "jumps left out"),
        "smoothing": plot_before_after(both, units, kept, smoothed, "smoothed, and velocities"),
        "cropping": plot_before_after(NAMES, UNITS, uncropped, unaligned, "rests cut off"),
        "strokes": plot_before_after(
            NAMES, UNITS, unaligned, [(base, one) for one in shown], "aligned"
        ),
        "control_rate": plot_before_after(
            NAMES,
            UNITS,
            [(base, one) for one in shown],
            [(control, one) for one in at_control_rate],
            "at 10 Hz",
            markers=True,
        ),
    }
    for name, picture in pictures.items():
        save_figure(picture, FOLDER / f"{name}.png")
    print_errors(kept, smoothed, truth)


def print_errors(kept: list[Timed], smoothed: list[Timed], truth: tuple[Timed, ...]) -> None:
    """Root mean square errors of positions and velocities, before smoothing and after it."""
    rows = []
    for (times, values), (_, found), (instants, known) in zip(kept, smoothed, truth, strict=True):
        right = known[torch.isin(instants, times)]
        slopes = torch.stack(
            [torch.gradient(column, spacing=(times,))[0] for column in values.unbind(-1)], -1
        )
        rows.append(
            torch.stack(
                [
                    values - right[:, :2],
                    found[:, :2] - right[:, :2],
                    slopes - right[:, 2:],
                    found[:, 2:] - right[:, 2:],
                ]
            )
        )
    raw, left, differences, derived = torch.cat(rows, 1).square().mean((1, 2)).sqrt().tolist()
    print(f"positions: {1000 * raw:.2f} mm rms before smoothing, {1000 * left:.2f} mm after it")
    print(
        f"velocities: {differences:.3f} m/s rms by differences, {derived:.3f} m/s of the smoothed "
        "positions"
    )


if __name__ == "__main__":
    main()
