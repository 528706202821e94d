"""The cross-entropy method, for the plans of many robots at once."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def minimise_by_cem(
    cost: Callable[[Tensor], Tensor],
    mean: Tensor,
    std: float,
    candidates: int,
    elites: int,
    iterations: int,
    generator: torch.Generator,
) -> Tensor:
    """The cross-entropy method: a Gaussian is fitted to the best of its draws, again and again.

    Args:
        cost: of plans (*batch, candidates, H, F) in [-1, 1], (*batch, candidates).
        mean: of the first draws, (*batch, H, F).
        std: of the first draws.
        candidates, elites: number of draws, and of the best of them.
        iterations: number of fits.
        generator: of the draws.

    Returns:
        The last mean, (*batch, H, F).

    Example:
        >>> generator = torch.Generator().manual_seed(0)
        >>> def cost(plans: Tensor) -> Tensor:
        ...     return (plans - 0.3).square().sum((-2, -1))
        >>> plan = minimise_by_cem(cost, torch.zeros(1, 2, 1), 0.5, 200, 20, 8, generator)
        >>> bool((plan - 0.3).abs().max() < 0.02)
        True
    """
    stds = torch.full_like(mean, std)
    for _ in range(iterations):
        shape = (*mean.shape[:-2], candidates, *mean.shape[-2:])
        noise = torch.randn(shape, generator=generator)
        plans = (mean.unsqueeze(-3) + stds.unsqueeze(-3) * noise).clamp(-1, 1)
        best = cost(plans).topk(elites, largest=False).indices[..., None, None]
        chosen = plans.gather(-3, best.expand(*best.shape[:-2], *plans.shape[-2:]))
        mean, stds = chosen.mean(-3), chosen.std(-3)
    return mean
