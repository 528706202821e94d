r"""Closed-form moments of sines and cosines of a Gaussian.

A sine is a cosine a quarter turn earlier, so one formula serves all: for phases :math:`\varphi \sim
\mathcal N(m, V)`,

.. math::
    \mathbb E \cos\varphi_i &= e^{-V_{ii}/2} \cos m_i \\
    \operatorname{cov}(\cos\varphi_i, \cos\varphi_j) &= e^{-(V_{ii} + V_{jj})/2}
        \left[ (\cosh V_{ij} - 1) \cos m_i \cos m_j + \sinh V_{ij} \sin m_i \sin m_j \right]

and by Stein's lemma :math:`\Sigma_x^{-1} \operatorname{cov}(x, \cos\varphi_i)` is the mean
derivative of the cosine by x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gp.gaussian import Gaussian, apply, symmetric

QUARTER_TURN = math.pi / 2


def augment(belief: Gaussian, plain: Tensor, angles: Tensor) -> tuple[Gaussian, Tensor]:
    r"""Belief over :math:`[Px, \sin(Ax), \cos(Ax)]` when x is Gaussian: exact mean and covariance.

    Args:
        belief: belief over the D entries of x; those that A combines are in rad.
        plain: the matrix P, (K_p, D).
        angles: the matrix A, (K, D); a row with a single 1 picks an entry.

    Returns:
        The belief of K_p + 2K entries, and :math:`\Sigma_x^{-1} \operatorname{cov}(x, \cdot)`,
        (*batch, D, K_p + 2K).

    Source: Deisenroth (2010), appendix A.

    Example:
        >>> eighth_turn = Gaussian(torch.tensor([torch.pi / 4]), torch.zeros(1, 1))
        >>> augment(eighth_turn, torch.ones(1, 1), torch.ones(1, 1))[0].mean
        tensor([0.7854, 0.7071, 0.7071])
    """
    return Augmentation.of(plain, angles)(belief)


@dataclass(frozen=True, eq=False)
class Augmentation:
    """:func:`augment` for many beliefs: one matrix, and a cosine of its last results."""

    rows: Tensor  # P, A and A again, (K_p + 2K, D)
    turns: Tensor  # -pi/2 at the first A, so that the cosine is a sine, else 0, (K_p + 2K,)
    kept: int  # K_p

    @classmethod
    def of(cls, plain: Tensor, angles: Tensor) -> Augmentation:
        """From the matrices P and A of :func:`augment`."""
        turns = angles.new_zeros(len(plain) + 2 * len(angles))
        turns[len(plain) : len(plain) + len(angles)] = -QUARTER_TURN
        return cls(torch.cat([plain, angles, angles]), turns, len(plain))

    def to(self, other: Tensor) -> Augmentation:
        """This augmentation with the dtype and on the device of another tensor."""
        same = (self.rows.dtype, self.rows.device) == (other.dtype, other.device)
        return self if same else Augmentation(self.rows.to(other), self.turns.to(other), self.kept)

    def __call__(self, belief: Gaussian) -> tuple[Gaussian, Tensor]:
        """Belief and covariance with x as :func:`augment` returns them."""
        kept = self.kept
        mean = torch.nn.functional.linear(belief.mean, self.rows, self.turns)
        linear_cov = self.rows @ belief.cov @ self.rows.mT
        cosine, cosine_cov, slope = apply(_Cosines, mean[..., kept:], linear_cov[..., kept:, kept:])
        gain = torch.nn.functional.pad(slope, (kept, 0), value=1.0)[..., None, :]
        cov = gain.mT * linear_cov * gain
        cov[..., kept:, kept:] = cosine_cov
        return Gaussian(torch.cat([mean[..., :kept], cosine], -1), cov), self.rows.mT * gain


def squash(belief: Gaussian, u_max: Tensor) -> tuple[Gaussian, Tensor]:
    r"""Belief over :math:`u_{\max} \sin(v)` when v is Gaussian (Eq. 27): exact mean and covariance.

    Args:
        belief: belief over the F entries of the unsquashed action v.
        u_max: largest absolute actions (F,), in their units.

    Returns:
        The belief over the action, and the diagonal of :math:`\Sigma_v^{-1} \operatorname{cov}(v,
        u)`, (*batch, F).

    Example:
        >>> v = Gaussian(torch.tensor([torch.pi / 2]), torch.zeros(1, 1))
        >>> squash(v, torch.tensor([3.5]))[0].mean
        tensor([3.5000])
    """
    mean, cov, slope = apply(_Cosines, belief.mean - QUARTER_TURN, belief.cov)
    return Gaussian(u_max * mean, u_max[:, None] * cov * u_max), u_max * slope


class _Cosines(torch.autograd.Function):
    """Mean (*batch, K), covariance (*batch, K, K) and mean slope -E sin of cosines of phases."""

    @staticmethod
    def forward(m: Tensor, V: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        decay, even, odd = _coefficients(V)
        cos, sin = m.cos(), m.sin()
        return decay * cos, even * _square(cos) + odd * _square(sin), -decay * sin

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: object) -> None:
        ctx.save_for_backward(*inputs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_mean: Tensor, d_cov: Tensor, d_slope: Tensor) -> tuple[Tensor, Tensor]:
        m, V = ctx.saved_tensors
        return cosines_adjoint(m, V, d_mean, symmetric(d_cov), d_slope)


def cosines_adjoint(
    m: Tensor, V: Tensor, d_mean: Tensor, d_cov: Tensor, d_slope: Tensor
) -> tuple[Tensor, Tensor]:
    """Cotangents of the phases from those of mean, covariance (symmetric) and slope of cosines."""
    decay, even, odd = _coefficients(V)
    cos, sin = m.cos(), m.sin()
    cos_cos, sin_sin, level = _square(cos), _square(sin), even + _square(decay)
    by_cos, by_sin = (
        (d_cov * part * values[..., None, :]).sum(-1) for part, values in ((even, cos), (odd, sin))
    )
    d_m = 2 * (cos * by_sin - sin * by_cos) - decay * (d_mean * sin + d_slope * cos)
    by_decay = decay * (d_mean * cos - d_slope * sin) / 2
    d_variance = (d_cov * (even * cos_cos + odd * sin_sin)).sum(-1) + by_decay
    return d_m, d_cov * (odd * cos_cos + level * sin_sin) - torch.diag_embed(d_variance)


def _coefficients(V: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    r"""The factors :math:`e^{-V_{ii}/2}`, and those of the products of cosines and of sines.

    The latter are :math:`\cosh V_{ij} - 1` and :math:`\sinh V_{ij}`, times :math:`e^{-(V_{ii} +
    V_{jj})/2}`. No exponential overflows, however large the variance.
    """
    exponent, size = V.diagonal(dim1=-2, dim2=-1)[..., None] / -2, V.abs()
    growth = torch.exp(size + exponent + exponent.mT) * torch.expm1(-2 * size)
    odd = torch.copysign(growth / 2, V)
    return exponent.squeeze(-1).exp(), odd * torch.tanh(V / 2), odd


def _square(vector: Tensor) -> Tensor:
    """Outer product of a vector (*batch, K) with itself."""
    return vector[..., :, None] * vector[..., None, :]
