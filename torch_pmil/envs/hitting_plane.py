"""The vertical plane of the balls in front of the BioRob (Sec. 5.2.5, Figure 11)."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.envs.biorob import BALL

TARGET_NAMES = ("y", "z")
# (3, 2), m, chosen
TRAINING_TARGETS = torch.tensor([[0.0, 0.0], [0.2, -0.16], [-0.2, -0.16]], dtype=torch.float64)
COLUMNS = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)  # y of the grid's columns, m, chosen
ROWS = (-0.24, -0.16, -0.08, 0.0, 0.08)  # z of its rows
# (35, 2), row by row, the lowest first
GRID = torch.tensor([[y, z] for z in ROWS for y in COLUMNS], dtype=torch.float64)


def ball_at(targets: Tensor) -> Tensor:
    """Position [x, y, z] of the ball of each target, (*batch, 3), m, float64.

    The plane is perpendicular to x; its origin is the ball of the experiment with one target, y is
    to the left, z up. Stated in the paper: three training targets, and a grid of 7 x 5 test targets
    that reaches beyond them. Chosen here: a triangle with the origin at its top, in a grid that
    reaches 0.1 m further to the left and right and 0.08 m further up and down. A strike of the
    demonstrated style (``Strike.towards``) hits all of it with torques within the limits. The
    strike towards the nearest training target misses balls between and beyond.

    Args:
        targets: [y, z] in the plane, (*batch, 2), m.

    Raises:
        ValueError: the last dimension is not 2.

    Example:
        >>> ball_at(torch.tensor([0.0, 0.1]))
        tensor([0.7570, 0.0760, 1.2270], dtype=torch.float64)
    """
    if targets.ndim < 1 or targets.shape[-1] != 2:
        raise ValueError(f"targets must have shape (*batch, 2), got {tuple(targets.shape)}")
    origin = torch.tensor(BALL, dtype=torch.float64)
    return origin + torch.cat([torch.zeros_like(targets[..., :1]), targets], -1).to(torch.float64)
