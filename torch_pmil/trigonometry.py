r"""Closed-form moments of sines and cosines of a Gaussian.

A sine is a cosine a quarter turn earlier, so one formula serves all: for phases :math:`\varphi \sim \mathcal N(m, V)`,

.. math::
    \mathbb E \cos\varphi_i &= e^{-V_{ii}/2} \cos m_i \\
    \operatorname{cov}(\cos\varphi_i, \cos\varphi_j) &= e^{-(V_{ii} + V_{jj})/2}
        \left[ (\cosh V_{ij} - 1) \cos m_i \cos m_j + \sinh V_{ij} \sin m_i \sin m_j \right]

and by Stein's lemma :math:`\Sigma_x^{-1} \operatorname{cov}(x, \cos\varphi_i)` is the mean derivative of the cosine by x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
    return Augmentation.of(plain, angles)(belief)


@dataclass(frozen=True)
class Augmentation:
    """:func:`augment` for many beliefs: everything linear in x by one matrix, the last entries then through the cosine."""

    rows: Tensor  # P, A and A again, (K_p + 2K, D)
    turns: Tensor  # turns the first copy of the angles to phases of which the cosine is their sine, (K_p + 2K,)
    kept: int  # K_p

    @classmethod
    def of(cls, plain: Tensor, angles: Tensor) -> Augmentation:
        """From the matrices P and A of :func:`augment`."""
        turns = angles.new_zeros(len(plain) + 2 * len(angles))
        turns[len(plain) : len(plain) + len(angles)] = -QUARTER_TURN
        return cls(torch.cat([plain, angles, angles]), turns, len(plain))

    def to(self, other: Tensor) -> Augmentation:
        """With the dtype and on the device of another tensor."""
        same = (self.rows.dtype, self.rows.device) == (other.dtype, other.device)
        return self if same else Augmentation(self.rows.to(other), self.turns.to(other), self.kept)

    def __call__(self, belief: Gaussian) -> tuple[Gaussian, Tensor]:
        """As :func:`augment`."""
        columns, kept = self.rows.mT, self.kept
        mean = torch.nn.functional.linear(belief.mean, self.rows, self.turns)
        cov = self.rows @ belief.cov @ columns
        cosine, cosine_cov, slope = _cosines(mean[..., kept:], cov[..., kept:, kept:])
        gain = torch.nn.functional.pad(slope, (kept, 0), value=1.0)[..., None, :]
        cov = gain.mT * cov * gain
        cov[..., kept:, kept:] = cosine_cov
        return Gaussian(torch.cat([mean[..., :kept], cosine], -1), cov), columns * gain


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
    mean, cov, slope = _cosines(belief.mean - QUARTER_TURN, belief.cov)
    return Gaussian(u_max * mean, u_max[:, None] * cov * u_max), u_max * slope


def _cosines(m: Tensor, V: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """:class:`_Cosines`, without its overhead where no graph is recorded."""
    return (_Cosines.apply if torch.is_grad_enabled() else _Cosines.forward)(m, V)


class _Cosines(torch.autograd.Function):
    r"""Mean (*batch, K) and covariance (*batch, K, K) of the cosines of Gaussian phases, and the mean slope -E sin (*batch, K)."""

    @staticmethod
    def forward(m, V):
        decay, even, odd = _coefficients(V)
        cos, sin = m.cos(), m.sin()
        return decay * cos, even * _square(cos) + odd * _square(sin), -decay * sin

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs, output[1])

    @staticmethod
    @once_differentiable
    def backward(ctx, d_mean, d_cov, d_slope):
        m, V, cov = ctx.saved_tensors
        decay, even, odd = _coefficients(V)
        cos, sin = m.cos(), m.sin()
        both = d_cov + d_cov.mT
        by_cos, by_sin = (((both * part) @ values[..., None]).squeeze(-1) for part, values in ((even, cos), (odd, sin)))
        d_m = cos * by_sin - sin * by_cos - decay * (d_mean * sin + d_slope * cos)
        d_variance = ((both * cov).sum(-1) + decay * (d_mean * cos - d_slope * sin)) / -2
        by_V = odd * _square(cos) + (even + _square(decay)) * _square(sin)
        return d_m, d_cov * by_V + torch.diag_embed(d_variance)


def _coefficients(V: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    r""":math:`e^{-V_{ii}/2}`, and what multiplies the products of cosines and of sines: :math:`\cosh V_{ij} - 1` and
    :math:`\sinh V_{ij}`, each times :math:`e^{-(V_{ii} + V_{jj})/2}`. No exponential overflows, however large the variance.
    """
    exponent, size = V.diagonal(dim1=-2, dim2=-1)[..., None] / -2, V.abs()
    growth = torch.exp(size + exponent + exponent.mT) * torch.expm1(-2 * size)
    odd = torch.copysign(growth / 2, V)
    return exponent.squeeze(-1).exp(), odd * torch.tanh(V / 2), odd


def _square(vector: Tensor) -> Tensor:
    """Outer product of (*batch, K) with itself."""
    return vector[..., :, None] * vector[..., None, :]
