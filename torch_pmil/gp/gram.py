"""Kernel values of all pairs of two sets of points, for several outputs at once."""

from __future__ import annotations

import torch
from torch import Tensor


def gram(x: Tensor, y: Tensor, lengthscales: Tensor, signal_variance: Tensor) -> Tensor:
    r"""Values :math:`k_a(x_i, y_j)` of the kernel of Eq. 5, (E, n, m).

    Squared distances come from one matrix product. Their points are taken around the mean of ``y``,
    far from which they lose digits.

    Args:
        x: (n, D), or (E, n, D) where the outputs have points of their own.
        y: (m, D) or (E, m, D).
        lengthscales: (E, D).
        signal_variance: (E,).

    Example:
        >>> points = torch.tensor([[0.0], [2.0]])
        >>> gram(points, points[:1], torch.ones(1, 1), torch.ones(1)).flatten()
        tensor([1.0000, 0.1353])
    """
    centre = y.mean(-2, keepdim=True)
    scaled_x, scaled_y = ((points - centre) / lengthscales[:, None, :] for points in (x, y))
    half_x, half_y = (each.square().sum(-1, keepdim=True) / -2 for each in (scaled_x, scaled_y))
    with_signal = half_x + signal_variance.log()[:, None, None]
    left = torch.cat([scaled_x, with_signal, torch.ones_like(half_x)], -1)
    return torch.exp(left @ torch.cat([scaled_y, torch.ones_like(half_y), half_y], -1).mT)
