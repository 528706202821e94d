"""The demonstrated trajectory distribution (Eqs. 9-12), estimated from aligned demonstrations."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.checks import check_noise, check_tensor
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.gp.gaussian import Gaussian, symmetric


def expert_distribution(demonstrations: Demonstrations, noise_std: float | Tensor) -> Gaussian:
    r"""Demonstrated marginals at t = 1..T, unbiased, observation noise included (Eqs. 10-12).

    .. math:: \mathcal N(\hat\mu_t^{\exp}, \hat\Sigma_t^{\exp} + \sigma_{\mathrm{obs}}^2 I)

    The sample covariance of a few demonstrations is singular. The observation noise
    :math:`\sigma_{\mathrm{obs}}` is therefore part of the model, and the prediction has the same.

    Args:
        demonstrations: N aligned demonstrations of T + 1 samples, the first at t = 0.
        noise_std: standard deviation of the observation noise, in the units of the match space: one
            number, or one for each entry, (M,).

    Returns:
        Mean (T, M) and covariance (T, M, M).

    Raises:
        TypeError: the demonstrations have another type.
        ValueError: the noise is not positive, not finite, or has another number of entries.

    Example:
        >>> positions = torch.tensor([[[0.0], [1.0]], [[0.0], [3.0]]], dtype=torch.float64)
        >>> shown = Demonstrations(positions, 0.1, ("x",))
        >>> demonstrated = expert_distribution(shown, noise_std=0.5)
        >>> demonstrated.mean.item(), demonstrated.cov.item()
        (2.0, 2.25)
    """
    _check(demonstrations)
    observed = demonstrations.positions[:, 1:]
    noise = check_noise(noise_std, demonstrations.names)
    mean = observed.mean(0)  # Eq. 10
    deviation = observed - mean
    cov = torch.einsum("ntj,ntk->tjk", deviation, deviation) / (len(observed) - 1)  # Eq. 11
    return Gaussian(mean, symmetric(cov)).add_noise(noise**2)


def rms_error(demonstrations: Demonstrations, executed: Tensor) -> Tensor:
    r"""Root mean square distance (M,) of rollouts from the demonstrated mean (Eq. 10).

    .. math:: \sqrt{\frac{1}{N T} \sum_{n, t} (z_{nt} - \hat\mu_t^{\exp})^2}

    Args:
        demonstrations: of M entries.
        executed: rollouts in the match space, z_0..z_T, (N, T + 1, M).

    Raises:
        TypeError: the demonstrations have another type.
        ValueError: there is no rollout, or the rollouts have another shape or are not finite.

    Example:
        >>> import torch
        >>> shown = Demonstrations(torch.tensor([[[0.0], [1.0]], [[0.0], [3.0]]]), 0.1, ("q",))
        >>> rms_error(shown, torch.tensor([[[0.0], [5.0]]]))
        tensor([3.], dtype=torch.float64)
    """
    _check(demonstrations)
    check_tensor("executed", executed, ("N", *demonstrations.positions.shape[1:]))
    return (executed[:, 1:] - demonstrations.positions[:, 1:].mean(0)).square().mean((0, 1)).sqrt()


def demonstration_spread(demonstrations: Demonstrations) -> Tensor:
    r"""Standard deviation (M,) of the demonstrations (Eq. 11), without observation noise.

    .. math:: \sqrt{\frac{1}{T} \sum_t \hat\Sigma_{t, jj}^{\exp}}

    The expected rms error of a further demonstration is :math:`\sqrt{1 + 1/N}` times this.

    Example:
        >>> import torch
        >>> shown = Demonstrations(torch.tensor([[[0.0], [1.0]], [[0.0], [3.0]]]), 0.1, ("q",))
        >>> demonstration_spread(shown).square()
        tensor([2.0000], dtype=torch.float64)
    """
    _check(demonstrations)
    return demonstrations.positions[:, 1:].var(0).mean(0).sqrt()


def _check(demonstrations: Demonstrations) -> None:
    if not isinstance(demonstrations, Demonstrations):
        raise TypeError(
            f"demonstrations must be Demonstrations, got {type(demonstrations).__name__}"
        )
