"""Kullback-Leibler divergence of Gaussians, and of factorised trajectory distributions (Eqs. 19-24)."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.gaussian import Gaussian, cholesky


def _log_det(factor: Tensor) -> Tensor:
    return 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)


def gaussian_kl(p: Gaussian, q: Gaussian) -> Tensor:
    r"""Kullback-Leibler divergence KL(p‖q) of two Gaussians (Eq. 8 in closed form: Eq. 19, sign of the log term corrected).

    .. math:: \tfrac12 \left[ \operatorname{tr}(\Sigma_q^{-1}\Sigma_p) + \delta^\top \Sigma_q^{-1} \delta - D
              + \log\tfrac{|\Sigma_q|}{|\Sigma_p|} \right], \qquad \delta = \mu_p - \mu_q

    Its gradients are Eqs. 23 and 24 (the latter with the inner term :math:`\Sigma_p`, as it must be).

    Args:
        p, q: beliefs over D entries; batches broadcast. Both covariances positive definite.

    Returns:
        Nats, (*batch). Not symmetric: p is the demonstrated, q the predicted marginal.

    Raises:
        NotPositiveDefiniteError: names the batch element whose covariance has no Cholesky factor.

    Example:
        >>> p = Gaussian(torch.zeros(2), torch.eye(2))
        >>> gaussian_kl(p, p)
        tensor(0.)
    """
    L_p, L_q = cholesky(p.cov, "covariance of p"), cholesky(q.cov, "covariance of q")
    delta = (p.mean - q.mean)[..., None]
    residuals = torch.cat([L_p.expand(*delta.shape[:-2], -1, -1), delta], -1)
    white = torch.linalg.solve_triangular(L_q, residuals, upper=False)
    trace_and_mahalanobis = white.square().sum((-2, -1))
    return (trace_and_mahalanobis - p.dim + _log_det(L_q) - _log_det(L_p)) / 2


def trajectory_kl(expert: Gaussian, predicted: Gaussian) -> Tensor:
    r"""KL of two trajectory distributions that factorise over time (Eq. 20): the sum of their marginals' KLs.

    Args:
        expert, predicted: marginals at t = 1..T, mean (*batch, T, M), in the match space.

    Returns:
        Nats, (*batch).

    Example:
        >>> marginals = Gaussian(torch.zeros(25, 4), torch.eye(4).expand(25, 4, 4))
        >>> trajectory_kl(marginals, marginals)
        tensor(0.)
    """
    return gaussian_kl(expert, predicted).sum(-1)


def mean_kl(expert: Gaussian, mean: Tensor) -> Tensor:
    r"""KL of each marginal when the prediction is a mean alone, given the expert's covariance (Eq. 19 with equal covariances).

    .. math:: \tfrac12 \delta^\top (\Sigma^{\mathrm{exp}})^{-1} \delta

    Args:
        expert: marginals, mean (*batch, M).
        mean: predicted means (*batch, M).

    Returns:
        Nats, (*batch).

    Example:
        >>> mean_kl(Gaussian(torch.zeros(2), torch.eye(2)), torch.ones(2))
        tensor(1.)
    """
    L = cholesky(expert.cov, "covariance of the expert")
    white = torch.linalg.solve_triangular(L, (expert.mean - mean)[..., None], upper=False)
    return white.square().sum((-2, -1)) / 2
