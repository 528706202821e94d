r"""Exact moments of squared-exponential expansions at a Gaussian input (Eqs. 14-18), for GPs and RBF networks alike.

==========================================  ===========================================
paper                                       here
==========================================  ===========================================
:math:`\nu_i = x_i - \mu`                   ``nu`` (*batch, E, n, D)
:math:`q_i` (Eq. 15)                        ``q`` (*batch, E, n)
:math:`Q_{ij}` (Eq. 17)                     exp(row_i + u_i' G v_j + column_j), never stored for the gradient
:math:`\beta, K^{-1}`                       ``weights``, ``gram_inverse`` of the expansion
==========================================  ===========================================
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import gpytorch
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gaussian import Gaussian, cholesky, symmetric
from torch_pmil.kernel_expansion import KernelExpansion

CACHED_NUMBERS = 2**17  # numbers that are worked on at a time: 1 MB, half of a common level-2 cache


@dataclass(frozen=True)
class Moments:
    """Moments of f(x) when x is Gaussian and f an expansion of E outputs.

    ``inv_cov_cross_cov`` is Sigma_x^-1 cov(x, f), (*batch, D, E): multiply by Sigma_x for the covariance itself, see
    :meth:`cross_cov`. It stays finite where Sigma_x is singular.
    """

    mean: Tensor  # (*batch, E)
    cov: Tensor  # (*batch, E, E)
    inv_cov_cross_cov: Tensor  # (*batch, D, E)

    @property
    def gaussian(self) -> Gaussian:
        """The Gaussian with this mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def cross_cov(self, belief: Gaussian) -> Tensor:
        """cov(x, f), (*batch, D, E), for the ``belief`` over x that these moments were computed at."""
        return belief.cov @ self.inv_cov_cross_cov


def moment_match(model: KernelExpansion | gpytorch.models.ExactGP, belief: Gaussian, observation_noise: bool = False) -> Moments:
    r"""Mean, covariance and input-output covariance of a GP or an RBF network at an uncertain input (Eqs. 14-18).

    Exact, no sampling: the true distribution of f(x) is not Gaussian, its first two moments are these. Differentiable
    in the belief, the data and the hyper-parameters (once).

    Args:
        model: a trained GPyTorch ``ExactGP`` (``ScaleKernel(RBFKernel)``, zero or constant mean, E outputs as its batch), or a
            :class:`KernelExpansion`, which keeps its Cholesky factors' results between calls.
        belief: over the input, D entries, any batch shape; its covariance may be singular or zero.
        observation_noise: add the likelihood's noise to the variances (Eq. 5), as for the distribution of an observation.

    Returns:
        Moments in the units of the outputs.

    Raises:
        ValueError: the belief's entries are not the model's inputs.
        NotPositiveDefiniteError: the covariance has a clearly negative eigenvalue, or is not finite.

    Source: Deisenroth (2010), section 2.3.

    Example:
        >>> f = KernelExpansion(torch.zeros(1, 2), torch.ones(1, 1), torch.ones(1, 2), torch.ones(1))
        >>> moment_match(f, Gaussian(torch.zeros(2), torch.zeros(2, 2))).mean
        tensor([1.])
    """
    f = model if isinstance(model, KernelExpansion) else KernelExpansion.from_exact_gp(model)
    if belief.dim != f.num_inputs:
        raise ValueError(f"belief must have the model's {f.num_inputs} inputs, got {belief.dim}")
    terms = _Terms.of(f, belief)
    mean, inv_cov_cross_cov = _first_moment(f, terms)
    cov = _second_moment(f, terms) - mean[..., :, None] * mean[..., None, :]  # Eq. 16
    if f.gram_inverse is not None:
        variance = f.signal_variance + f.noise_variance if observation_noise else f.signal_variance
        cov = cov + torch.diag_embed(variance)
    return Moments(mean + f.offset, cov, inv_cov_cross_cov)


@dataclass(frozen=True)
class _Terms:
    r"""What Eqs. 15 and 17 have in common: a Gaussian integral of one kernel, or of the product of two.

    With :math:`u_i = \Lambda_a^{-1} \nu_i`, :math:`v_j = \Lambda_b^{-1} \nu_j`, P the sum of the precisions (:math:`\Lambda_a^{-1}` for one
    kernel, :math:`\Lambda_a^{-1} + \Lambda_b^{-1}` for a product) and :math:`G = (I + \Sigma P)^{-1} \Sigma`,

    .. math::
        \log q_i &= \log \alpha_a^2 - \tfrac12 \nu_i^\top u_i + \tfrac12 u_i^\top G u_i - \tfrac12 \log |I + \Sigma P| \\
        \log Q_{ij} &= \mathrm{row}_i + u_i^\top G v_j + \mathrm{column}_j

    where row is the expression for q and column the same for b without the determinant. K = E + E(E+1)/2 integrals:
    the E single kernels, and the products (see :class:`Products`).
    """

    u: Tensor  # (*batch, E, n, D), of the single kernels
    u_G: Tensor  # (*batch, E, n, D)
    log_q: Tensor  # (*batch, E, n)
    left: Tensor  # (*batch, K - E, n, D + 2), [u' G, row, 1] of the products
    right: Tensor  # (*batch, K - E, n, D + 2), [v', 1, column]

    @classmethod
    def of(cls, f: KernelExpansion, belief: Gaussian) -> _Terms:
        products, E = f.products, f.num_outputs
        sizes = [E, len(products.first), len(products.second)]
        nu = f.inputs - belief.mean[..., None, None, :]  # (*batch, E, n, D)
        scaled = nu * f.precision[:, None, :]
        log_k = f.log_signal_variance[:, None] - (nu * scaled).sum(-1) / 2
        G, log_det = _RegularisedCov.apply(belief.cov, products.precision)
        u = scaled.index_select(-3, products.factors)
        u_G = u @ G.index_select(-3, products.integrals)
        exponent = log_k.index_select(-2, products.factors) + (u_G * u).sum(-1) / 2
        (u, _, v), (u_G, u_G_products, _) = u.split(sizes, -3), u_G.split(sizes, -3)
        log_q, row, column = exponent.split(sizes, -2)
        half_log_det, half_log_det_products = (log_det[..., None] / 2).split(sizes[:2], -2)
        row = row - half_log_det_products
        one = torch.ones_like(row)[..., None]
        left = torch.cat([u_G_products, row[..., None], one], -1)
        right = torch.cat([v, one, column[..., None]], -1)
        return cls(u, u_G, log_q - half_log_det, left, right)


def _first_moment(f: KernelExpansion, terms: _Terms) -> tuple[Tensor, Tensor]:
    r"""Eqs. 14-15 without the offset, and the input-output covariance of each output a,

    .. math:: \Sigma^{-1} \operatorname{cov}(x, f_a) = (I - \Lambda_a^{-1} G) \sum_i \beta_i q_i u_i
    """
    beta_q = f.weights * terms.log_q.exp()  # Eq. 15
    direct, shrunk = ((beta_q[..., None, :] @ factor).squeeze(-2) for factor in (terms.u, terms.u_G))
    return beta_q.sum(-1), (direct - f.precision * shrunk).mT


def _second_moment(f: KernelExpansion, terms: _Terms) -> Tensor:
    """E[f_a f_b] without the offsets and without the prior variance, (*batch, E, E): the sums over Q of Eqs. 16-17."""
    if f.gram_inverse is None:
        w, z = f.weights.index_select(0, f.products.first), f.weights.index_select(0, f.products.second)
        sums = _OuterExpSum.apply(terms.left, terms.right, w, z)
    else:
        (own_left, left), (own_right, right) = (
            t.split([f.num_outputs, t.shape[-3] - f.num_outputs], -3) for t in (terms.left, terms.right)
        )
        own = _MatrixExpSum.apply(own_left, own_right, f.self_weights)
        w, z = f.pair_weights
        sums = torch.cat([own, _OuterExpSum.apply(left, right, w, z)], -1)
    E = f.num_outputs
    return sums.index_select(-1, f.products.position.flatten()).unflatten(-1, (E, E))


class _RegularisedCov(torch.autograd.Function):
    r"""G = (I + Sigma P)^-1 Sigma and log|I + Sigma P| for each diagonal P, a row of ``precision`` (K, D); exact at Sigma = 0.

    With R = I - G P: dG = R dSigma R' - G dP G and dlog|I + Sigma P| = tr(P R dSigma) + tr(G dP).
    """

    @staticmethod
    def forward(ctx, cov, precision):
        s = precision.sqrt()[:, :, None]
        identity = torch.eye(precision.shape[-1], dtype=cov.dtype, device=cov.device)
        scaled_cov = s * cov[..., None, :, :]
        factor = cholesky(identity + scaled_cov * s.mT, "I + Sigma P (last element: kernel, then pair of kernels)")
        G = symmetric(torch.cholesky_solve(scaled_cov, factor) / s)
        ctx.save_for_backward(precision, identity, G)
        return G, 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)

    @staticmethod
    @once_differentiable
    def backward(ctx, d_G, d_log_det):
        precision, identity, G = ctx.saved_tensors
        R = identity - G * precision[:, None, :]
        scale = d_log_det[..., None, None]
        d_cov = (R.mT @ d_G @ R + scale * symmetric(precision[:, :, None] * R)).sum(-3)
        if not ctx.needs_input_grad[1]:
            return d_cov, None
        d_P = (scale * G - G @ d_G @ G).diagonal(dim1=-2, dim2=-1)
        return d_cov, _sum_batch(d_P, 2)


def _chunks(left: Tensor) -> Iterator[slice]:
    """Slices of the pairs, so that the (n, n) arrays of one slice stay in the cache."""
    *batch, pairs, n, _ = left.shape
    size = max(1, CACHED_NUMBERS // (math.prod(batch) * n * n))
    return (slice(start, start + size) for start in range(0, pairs, size))


class _OuterExpSum(torch.autograd.Function):
    r"""S_p = sum_ij w_i z_j exp(l_i . r_j) for every pair p; its gradient keeps thin products instead of n^2 numbers.

    Row and column terms ride along in the matrix product: ``left`` ends in [row, 1] and ``right`` in [1, column].
    Shapes: left, right (*batch, P, n, d); w, z (P, n).
    """

    @staticmethod
    def forward(ctx, left, right, w, z):
        weighted_left, weighted_right = w[..., None] * left, z[..., None] * right
        Q_right, Q_left = torch.empty_like(left), torch.empty_like(right)
        for p in _chunks(left):
            Q = (left[..., p, :, :] @ right[..., p, :, :].mT).exp_()
            torch.matmul(Q, weighted_right[..., p, :, :], out=Q_right[..., p, :, :])
            torch.matmul(Q.mT, weighted_left[..., p, :, :], out=Q_left[..., p, :, :])
        ctx.save_for_backward(w, z, Q_right, Q_left)
        return (w * Q_right[..., -2]).sum(-1)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        w, z, Q_right, Q_left = ctx.saved_tensors
        scale = grad[..., None]
        d_left, d_right = (scale * w)[..., None] * Q_right, (scale * z)[..., None] * Q_left
        if not ctx.needs_input_grad[2]:
            return d_left, d_right, None, None
        return d_left, d_right, _sum_batch(scale * Q_right[..., -2], 2), _sum_batch(scale * Q_left[..., -1], 2)


class _MatrixExpSum(torch.autograd.Function):
    r"""S_p = sum_ij M_ij exp(l_i . r_j): as :class:`_OuterExpSum`, with a matrix of weights M (P, n, n) for each pair."""

    @staticmethod
    def forward(ctx, left, right, M):
        d_left, d_right = torch.empty_like(left), torch.empty_like(right)
        Qs = []
        for p in _chunks(left):
            Q = (left[..., p, :, :] @ right[..., p, :, :].mT).exp_()
            W = M[p] * Q if ctx.needs_input_grad[2] else Q.mul_(M[p])
            torch.matmul(W, right[..., p, :, :], out=d_left[..., p, :, :])
            torch.matmul(W.mT, left[..., p, :, :], out=d_right[..., p, :, :])
            Qs += [Q] if ctx.needs_input_grad[2] else []
        ctx.save_for_backward(d_left, d_right, *Qs)
        return d_left[..., -2].sum(-1)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        d_left, d_right, *Qs = ctx.saved_tensors
        scale = grad[..., None, None]
        d_M = _sum_batch(scale * torch.cat(Qs, -3), 3) if Qs else None
        return scale * d_left, scale * d_right, d_M


def _sum_batch(tensor: Tensor, keep: int) -> Tensor:
    """Sum over all leading dimensions but the last ``keep``."""
    return tensor.reshape(-1, *tensor.shape[-keep:]).sum(0)
