r"""Closed-form moments of sines and cosines of a Gaussian.

A sine is a cosine a quarter turn earlier, so one formula serves all: for phases :math:`\varphi \sim \mathcal N(m, V)`,

.. math::
    \mathbb E \cos\varphi_i &= e^{-V_{ii}/2} \cos m_i \\
    \operatorname{cov}(\cos\varphi_i, \cos\varphi_j) &= \tfrac12 e^{-(V_{ii} + V_{jj})/2}
        \left[ (e^{V_{ij}} - 1) \cos(m_i - m_j) + (e^{-V_{ij}} - 1) \cos(m_i + m_j) \right]

and by Stein's lemma :math:`\Sigma_x^{-1} \operatorname{cov}(x, \cos\varphi_i)` is the mean derivative of the cosine by x.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gaussian import Gaussian

QUARTER_TURN = math.pi / 2


def augment(belief: Gaussian, plain: Tensor, angles: Tensor) -> tuple[Gaussian, Tensor]:
    r"""Belief over :math:`[Px, \sin(Ax), \cos(Ax)]` when x is Gaussian: exact mean and covariance.

    Args:
        belief: over x, D entries; those that A combines in rad.
        plain: the matrix P, (K_p, D), of what is kept as it is.
        angles: the matrix A, (K, D), of what becomes sin and cos (a row with a single 1 picks an entry).

    Returns:
        The belief of K_p + 2K entries, and :math:`\Sigma_x^{-1} \operatorname{cov}(x, \cdot)`, (*batch, D, K_p + 2K).

    Source: Deisenroth (2010), appendix A.

    Example:
        >>> eighth_turn = Gaussian(torch.tensor([torch.pi / 4]), torch.zeros(1, 1))
        >>> augment(eighth_turn, torch.ones(1, 1), torch.ones(1, 1))[0].mean
        tensor([0.7854, 0.7071, 0.7071])
    """
    sizes = [len(plain), 2 * len(angles)]
    rows = torch.cat([plain, angles, angles])
    linear = belief.affine(rows, _quarter_turns(plain, angles))
    kept, phase = linear.mean.split(sizes, -1)
    upper, lower = linear.cov.split(sizes, -2)
    (cov_kept, cov_kept_phase), (_, cov_phase) = upper.split(sizes, -1), lower.split(sizes, -1)
    mean, cov, slope = _Cosines.apply(phase, cov_phase)
    cross = cov_kept_phase * slope[..., None, :]
    full = torch.cat([torch.cat([cov_kept, cross], -1), torch.cat([cross.mT, cov], -1)], -2)
    gain = torch.cat([torch.ones_like(kept), slope], -1)
    return Gaussian(torch.cat([kept, mean], -1), full), rows.mT * gain[..., None, :]


def _quarter_turns(plain: Tensor, angles: Tensor) -> Tensor:
    """What turns the first copy of the angles to phases of which the cosine is their sine."""
    return torch.cat([plain.new_zeros(len(plain)), angles.new_full((len(angles),), -QUARTER_TURN), angles.new_zeros(len(angles))])


def squash(belief: Gaussian, u_max: Tensor) -> tuple[Gaussian, Tensor]:
    r"""Belief over :math:`u_{\max} \sin(v)` when v is Gaussian (Eq. 27): exact mean and covariance.

    Args:
        belief: over the unsquashed action v, F entries.
        u_max: torque limits (F,), in the unit of the action.

    Returns:
        The belief over the action, and the diagonal of :math:`\Sigma_v^{-1} \operatorname{cov}(v, u)`, (*batch, F).

    Example:
        >>> v = Gaussian(torch.tensor([torch.pi / 2]), torch.zeros(1, 1))
        >>> squash(v, torch.tensor([3.5]))[0].mean
        tensor([3.5000])
    """
    mean, cov, slope = _Cosines.apply(belief.mean - QUARTER_TURN, belief.cov)
    return Gaussian(u_max * mean, u_max[:, None] * cov * u_max), u_max * slope


class _Cosines(torch.autograd.Function):
    r"""Mean (*batch, K) and covariance (*batch, K, K) of the cosines of Gaussian phases, and the mean slope -E sin (*batch, K).

    The covariance is :math:`A \cos(m_i - m_j) + B \cos(m_i + m_j)`. With :math:`a = |V_{ij}|` no exponential overflows, however
    large the variance.
    """

    @staticmethod
    def forward(ctx, m, V):
        variance = V.diagonal(dim1=-2, dim2=-1)
        decay = torch.exp(-variance / 2)
        half_sum = (variance[..., :, None] + variance[..., None, :]) / 2
        positive, a = V >= 0, V.abs()
        large, small = torch.exp(a - half_sum) / 2, torch.exp(-a - half_sum) / 2
        rise = torch.expm1(-a)
        plus, minus = -large * rise, torch.exp(-half_sum) * rise / 2
        A, B = torch.where(positive, plus, minus), torch.where(positive, minus, plus)
        difference, total = m[..., :, None] - m[..., None, :], m[..., :, None] + m[..., None, :]
        cos_difference, cos_total = difference.cos(), total.cos()
        cov = A * cos_difference + B * cos_total
        by_m = -A * difference.sin() - B * total.sin()
        by_V = torch.where(positive, large, small) * cos_difference - torch.where(positive, small, large) * cos_total
        mean, slope = decay * m.cos(), -decay * m.sin()
        ctx.save_for_backward(mean, cov, slope, by_m, by_V)
        return mean, cov, slope

    @staticmethod
    @once_differentiable
    def backward(ctx, d_mean, d_cov, d_slope):
        mean, cov, slope, by_m, by_V = ctx.saved_tensors
        both = d_cov + d_cov.mT
        d_m = (both * by_m).sum(-1) + d_mean * slope - d_slope * mean
        d_variance = ((both * cov).sum(-1) + d_mean * mean + d_slope * slope) / -2
        return d_m, d_cov * by_V + torch.diag_embed(d_variance)
