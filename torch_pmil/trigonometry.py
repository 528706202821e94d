r"""Closed-form moments of sines and cosines of a Gaussian.

==================  ==========================================
paper / formula     here
==================  ==========================================
theta ~ N(m, V)     ``angles`` (Gaussian)
E sin(theta)        exp(-V_ii / 2) sin(m_i)
u_max sin(pi~)      :func:`squash` (Eq. 27)
==================  ==========================================

Valid while no angle has a variance above about 700 rad^2 (a standard deviation of 26 rad): beyond, ``exp`` overflows and
the result is not finite, which the callers report.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.gaussian import Gaussian


def _sine_terms(angles: Gaussian) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Means of sin and cos (*batch, K), and the four products from which every covariance is put together (*batch, K, K)."""
    m, V = angles.mean, angles.cov
    variance = V.diagonal(dim1=-2, dim2=-1)
    decay = torch.exp(-variance / 2)
    scale = decay[..., :, None] * decay[..., None, :] / 2
    minus, plus = scale * torch.expm1(V), scale * torch.expm1(-V)
    difference, total = m[..., :, None] - m[..., None, :], m[..., :, None] + m[..., None, :]
    return decay * m.sin(), decay * m.cos(), minus, plus, difference, total


def augment(belief: Gaussian, angles: Tensor) -> tuple[Gaussian, Tensor]:
    r"""Belief over :math:`[x, \sin(Ax), \cos(Ax)]` when x is Gaussian: exact mean and covariance.

    Args:
        belief: over x, D entries; the entries that A combines in rad.
        angles: the matrix A, (K, D); its rows combine the entries to angles (a row of one 1 picks an entry).

    Returns:
        The augmented belief of D + 2K entries, and :math:`\Sigma_x^{-1} \operatorname{cov}(x, \cdot)`, (*batch, D, D + 2K).

    Source: Deisenroth (2010), appendix A.

    Example:
        >>> upright = Gaussian(torch.zeros(1), torch.zeros(1, 1))
        >>> augment(upright, torch.ones(1, 1))[0].mean
        tensor([0., 0., 1.])
    """
    theta = belief.affine(angles)
    sin, cos, minus, plus, difference, total = _sine_terms(theta)
    cov_ss = minus * difference.cos() - plus * total.cos()
    cov_cc = minus * difference.cos() + plus * total.cos()
    cov_sc = minus * difference.sin() + plus * total.sin()
    cov_trig = torch.cat([torch.cat([cov_ss, cov_sc], -1), torch.cat([cov_sc.mT, cov_cc], -1)], -2)

    slope = torch.cat([cos[..., None] * angles, -sin[..., None] * angles], -2).mT  # Stein: E[d feature / dx]
    cross_cov = belief.cov @ slope
    cov = torch.cat([torch.cat([belief.cov, cross_cov], -1), torch.cat([cross_cov.mT, cov_trig], -1)], -2)
    identity = torch.eye(belief.dim, dtype=belief.mean.dtype, device=belief.mean.device)
    inv_cov_cross_cov = torch.cat([identity.expand_as(belief.cov), slope], -1)
    return Gaussian(torch.cat([belief.mean, sin, cos], -1), cov), inv_cov_cross_cov


def squash(belief: Gaussian, u_max: Tensor) -> tuple[Gaussian, Tensor]:
    r"""Belief over :math:`u_{\max} \sin(v)` when v is Gaussian (Eq. 27): exact mean and covariance.

    Args:
        belief: over the unsquashed action v, F entries.
        u_max: torque limits (F,), in the unit of the action.

    Returns:
        The belief over the action, and :math:`\Sigma_v^{-1} \operatorname{cov}(v, u)`, (*batch, F, F) and diagonal.

    Example:
        >>> v = Gaussian(torch.tensor([torch.pi / 2]), torch.zeros(1, 1))
        >>> squash(v, torch.tensor([3.5]))[0].mean
        tensor([3.5000])
    """
    sin, cos, minus, plus, difference, total = _sine_terms(belief)
    cov = (minus * difference.cos() - plus * total.cos()) * u_max[:, None] * u_max
    return Gaussian(u_max * sin, cov), torch.diag_embed(u_max * cos)
