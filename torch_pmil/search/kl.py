"""Kullback-Leibler divergence and cross-entropy of Gaussians (Eqs. 19-24)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian, check_moments, cholesky


def _log_det(factor: Tensor) -> Tensor:
    return 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)


def gaussian_kl(p: Gaussian, q: Gaussian) -> Tensor:
    r"""Kullback-Leibler divergence KL(p‖q) of two Gaussians (Eq. 19).

    It is Eq. 8 in closed form; the sign of Eq. 19's log term is corrected.

    .. math::
        \tfrac12 \left[ \operatorname{tr}(\Sigma_q^{-1}\Sigma_p)
        + \delta^\top \Sigma_q^{-1} \delta - D + \log\tfrac{|\Sigma_q|}{|\Sigma_p|} \right],
        \qquad \delta = \mu_p - \mu_q

    Its gradients are Eqs. 23 and 24, the inner term of the latter corrected to :math:`\Sigma_p`.

    Args:
        p, q: beliefs over D entries; batches broadcast. Both covariances positive definite.

    Returns:
        Nats, (*batch). Not symmetric: p is the demonstrated, q the predicted marginal.

    Raises:
        ValueError: entries, batches or dtypes of the two do not fit, or a mean is not finite.
        NotPositiveDefiniteError: a covariance is not positive definite, finite and symmetric; the
            message names the batch element.

    Example:
        >>> p = Gaussian(torch.zeros(2), torch.eye(2))
        >>> gaussian_kl(p, p)
        tensor(0.)
    """
    L_p, L_q, white = _whitened(p, q)
    trace_and_mahalanobis = white.square().sum((-2, -1))
    return (trace_and_mahalanobis - p.dim + _log_det(L_q) - _log_det(L_p)) / 2


def gaussian_cross_entropy(q: Gaussian, p: Gaussian) -> Tensor:
    r"""Cross-entropy of q relative to p: how surprising draws of q are under p.

    .. math::
        \mathbb E_q[-\log p] = \tfrac12 \left[ \operatorname{tr}(\Sigma_p^{-1}\Sigma_q)
        + \delta^\top \Sigma_p^{-1} \delta + \log |2\pi\Sigma_p| \right],
        \qquad \delta = \mu_p - \mu_q

    It is least for a q that is a point at the mean of p, whereas KL(p‖q) is least for q = p.

    Args:
        q: predicted marginals over D entries.
        p: demonstrated marginals; batches broadcast. Both covariances positive definite.

    Returns:
        Nats, (*batch).

    Raises:
        ValueError, NotPositiveDefiniteError: as in :func:`gaussian_kl`.

    Example:
        >>> p = Gaussian(torch.zeros(2), torch.eye(2))
        >>> gaussian_cross_entropy(Gaussian(torch.ones(2), torch.eye(2)), p)
        tensor(3.8379)
    """
    _, L_p, white = _whitened(q, p)
    return (white.square().sum((-2, -1)) + p.dim * math.log(2 * math.pi) + _log_det(L_p)) / 2


def _whitened(p: Gaussian, q: Gaussian) -> tuple[Tensor, Tensor, Tensor]:
    """Cholesky factors L_p and L_q, and L_q^-1 [L_p, mu_p - mu_q], (*batch, D, D + 1)."""
    check_moments(p, "p")
    check_moments(q, "q", p.mean)
    batches = zip(p.batch_shape[::-1], q.batch_shape[::-1], strict=False)
    if p.dim != q.dim or not all(a == b or 1 in (a, b) for a, b in batches):
        raise ValueError(
            "p and q must have the same entries, and batches that broadcast, got means "
            f"{tuple(p.mean.shape)} and {tuple(q.mean.shape)}"
        )
    L_p, L_q = cholesky(p.cov, "covariance of p"), cholesky(q.cov, "covariance of q")
    delta = (p.mean - q.mean)[..., None]
    residuals = torch.cat([L_p.expand(*delta.shape[:-2], -1, -1), delta], -1)
    return L_p, L_q, torch.linalg.solve_triangular(L_q, residuals, upper=False)


class KLTerms(NamedTuple):
    """Terms of a KL by entry, in nats; none is negative.

    Args:
        mean: terms from the difference of the means, (*batch, D).
        spread: terms from the difference of the covariances, (*batch, D).
    """

    mean: Tensor
    spread: Tensor


def gaussian_kl_terms(p: Gaussian, q: Gaussian) -> KLTerms:
    r"""Terms of KL(p‖q) by entry, whose sum is :func:`gaussian_kl` exactly (Eq. 19).

    By the chain rule a KL is the sum of the expected KLs of each entry given those before it. With
    Cholesky factors L, :math:`m = L_q^{-1} (\mu_p - \mu_q)` and :math:`M = L_q^{-1} L_p` these are

    .. math::
        \tfrac12 m_j^2 \quad\text{and}\quad
        \tfrac12 \Big[ \sum_{k \le j} M_{jk}^2 - 1 - \log M_{jj}^2 \Big].

    The sum of either kind does not depend on the order of the entries. Its parts do: a difference
    that two dependent entries both show counts with the first of them. Arguments and errors are
    those of :func:`gaussian_kl`.

    Example:
        >>> p = Gaussian(torch.zeros(2), torch.eye(2))
        >>> q = Gaussian(torch.tensor([0.0, 2.0]), torch.eye(2))
        >>> gaussian_kl_terms(p, q).mean
        tensor([0., 2.])
    """
    _, _, white = _whitened(p, q)
    M, m = white[..., :-1], white[..., -1]
    spread = (M.square().sum(-1) - 1) / 2 - M.diagonal(dim1=-2, dim2=-1).log()
    return KLTerms(m.square() / 2, spread)


def trajectory_kl(demonstrated: Gaussian, predicted: Gaussian) -> Tensor:
    """KL of two trajectory distributions that factorise over time: a sum over steps (Eq. 20).

    Args:
        demonstrated, predicted: marginals at t = 1..T, mean (*batch, T, M), in the match space.

    Returns:
        Nats, (*batch).

    Raises:
        ValueError, NotPositiveDefiniteError: the two differ in steps, or as in :func:`gaussian_kl`.

    Example:
        >>> marginals = Gaussian(torch.zeros(25, 4), torch.eye(4).expand(25, 4, 4))
        >>> trajectory_kl(marginals, marginals)
        tensor(0.)
    """
    kl = gaussian_kl(demonstrated, predicted)
    if not demonstrated.batch_shape[-1:] == predicted.batch_shape[-1:] == kl.shape[-1:] != ():
        raise ValueError(
            "demonstrated and predicted must be over the same steps, (*batch, T, M), got "
            f"{tuple(demonstrated.mean.shape)} and {tuple(predicted.mean.shape)}"
        )
    return kl.sum(-1)


def mean_kl(demonstrated: Gaussian, mean: Tensor) -> Tensor:
    r"""KL of each marginal to the predicted mean with the demonstrated covariance (Eq. 19).

    .. math:: \tfrac12 \delta^\top (\Sigma^{\mathrm{exp}})^{-1} \delta

    Args:
        demonstrated: marginals, mean (*batch, M).
        mean: predicted means (*batch, M).

    Returns:
        Nats, (*batch).

    Example:
        >>> mean_kl(Gaussian(torch.zeros(2), torch.eye(2)), torch.ones(2))
        tensor(1.)
    """
    L = cholesky(demonstrated.cov, "demonstrated covariance")
    white = torch.linalg.solve_triangular(L, (demonstrated.mean - mean)[..., None], upper=False)
    return white.square().sum((-2, -1)) / 2
