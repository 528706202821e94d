"""Strokes in a plane: shown, predicted and written."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_pmil.gaussian import Gaussian


@dataclass(frozen=True)
class Writing:
    """What was written, m, in the plane: x to the right, y up.

    Args:
        shown: strokes of people, (N, T + 1, 2).
        predicted: marginals of the tip at t = 1..T, mean (T, 2).
        written: strokes of the robot, (B, T + 1, 2).
    """

    shown: Tensor
    predicted: Gaussian
    written: Tensor
