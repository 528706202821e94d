"""From aligned demonstrations to the demonstrated trajectory distribution (Eqs. 9-12)."""

from __future__ import annotations

import torch

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.gaussian import Gaussian, symmetric


def expert_distribution(demonstrations: Demonstrations, noise_std: float) -> Gaussian:
    r"""Marginals :math:`\mathcal N(\hat\mu_t^{\exp}, \hat\Sigma_t^{\exp} + \sigma_{\mathrm{obs}}^2 I)` at t = 1..T, unbiased (Eqs. 10-12).

    A few demonstrations have a singular sample covariance, and positions of links lie on circles: the observation noise
    :math:`\sigma_{\mathrm{obs}}` is therefore part of the model, and the same is added to the prediction.

    Args:
        demonstrations: N aligned demonstrations of T + 1 samples, the first at t = 0.
        noise_std: standard deviation of the observation noise, in the unit of the match space.

    Returns:
        Mean (T, M) and covariance (T, M, M).

    Raises:
        ValueError: the noise is not positive.

    Example:
        >>> positions = torch.tensor([[[0.0], [1.0]], [[0.0], [3.0]]], dtype=torch.float64)
        >>> expert = expert_distribution(Demonstrations(positions, 0.1, ("x",)), noise_std=0.5)
        >>> expert.mean.item(), expert.cov.item()
        (2.0, 2.25)
    """
    if not noise_std > 0:
        raise ValueError(f"noise_std must be positive, got {noise_std}")
    observed = demonstrations.positions[:, 1:]
    mean = observed.mean(0)  # Eq. 10
    deviation = observed - mean
    cov = torch.einsum("ntj,ntk->tjk", deviation, deviation) / (len(observed) - 1)  # Eq. 11
    return Gaussian(mean, symmetric(cov)).add_noise(noise_std**2)
