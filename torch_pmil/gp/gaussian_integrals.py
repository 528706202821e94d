r"""Gaussian integrals of a squared-exponential kernel (Eq. 15) or of a product of two (Eq. 17)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gp.gaussian import Gaussian, apply, cholesky, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion


@dataclass(frozen=True, eq=False)
class GaussianIntegrals:
    r"""Integrals of the E kernels and of their P = E(E+1)/2 products over N beliefs.

    With :math:`\nu_i = x_i - \mu`, the precision P of the kernel (:math:`\Lambda_a^{-1}`, or of a
    product :math:`\Lambda_a^{-1} + \Lambda_b^{-1}`) and :math:`B = (\Sigma + P^{-1})^{-1}`,

    .. math::
        \log q_i &= \log \alpha_a^2 - \tfrac12 \log |I + \Sigma P| - \tfrac12 \nu_i^\top B \nu_i \\
        \log Q_{ij} &= \log \alpha_a^2 \alpha_b^2 - \tfrac12 \log |I + \Sigma P|
            - \tfrac12 \nu_{ij}^\top B \nu_{ij}
            - \tfrac12 (x_i - x_j)^\top (\Lambda_a + \Lambda_b)^{-1} (x_i - x_j)

    where :math:`\nu_{ij} = P^{-1} (\Lambda_a^{-1} \nu_i + \Lambda_b^{-1} \nu_j)` is the centre of
    the product of the two kernels: Eq. 17 with the squares completed. All outputs share the inputs,
    so that one matrix product gives all quadratic forms.

    Args:
        nu1: nu, and a last row of ones, (N, D + 1, n).
        precision: B, (N, E + P, D, D).
        q: (N, E, n).
        left, right: log Q_ij = left_i . right_j, (N, P, D + 2, n). ``left`` is [nu, 1, terms of i],
            ``right`` [.., terms of j, 1].
    """

    nu1: Tensor
    precision: Tensor
    q: Tensor
    left: Tensor
    right: Tensor

    @classmethod
    def of(cls, f: KernelExpansion, belief: Gaussian) -> GaussianIntegrals:
        """Integrals of the kernels of ``f`` over N beliefs, mean (N, D).

        Raises ValueError at other inputs, and NotPositiveDefiniteError at a covariance that is not
        finite or has a clearly negative eigenvalue.
        """
        D, E, pairs = f.num_inputs, f.num_outputs, f.pairs
        if belief.dim != D:
            raise ValueError(f"belief must have the model's {D} inputs, got {belief.dim}")
        nu1, squares = _centred(f, belief.mean)
        B, half_log_det = apply(_RegularisedPrecision, belief.cov, pairs.precision, pairs.root)
        P = len(pairs.first)
        forms = torch.addcmul(pairs.constant, pairs.factor, B.index_select(1, pairs.integrals))
        own_forms, cross_forms = forms.split([E + 2 * P, P], 1)
        constant = torch.nn.functional.linear(half_log_det, pairs.minus_log_det, pairs.log_factor)
        exponents = torch.baddbmm(constant[:, :, None], own_forms.flatten(2), squares)
        log_q, i_terms, j_terms = exponents[:, :, None].split([E, P, P], 1)
        repeated = nu1[:, None].expand(-1, P, -1, -1)
        left = torch.cat([repeated, i_terms], 2)
        cross_terms = (cross_forms.flatten(1, 2) @ nu1[:, :D]).unflatten(1, (P, D))
        right = torch.cat([cross_terms, j_terms, repeated[:, :, D:]], 2)
        return cls(nu1, B, log_q.exp().squeeze(2), left, right)


def _centred(f: KernelExpansion, mean: Tensor) -> tuple[Tensor, Tensor]:
    """Inputs nu less the means (N, D), with a last row of ones, (N, D + 1, n), and nu nu'."""
    nu1 = f.inputs_and_one - torch.nn.functional.pad(mean, (0, 1))[:, :, None]
    nu = nu1[:, :-1]
    return nu1, (nu[:, :, None] * nu[:, None]).flatten(1, 2)


class _RegularisedPrecision(torch.autograd.Function):
    r"""The matrices B = (Sigma + P^-1)^-1 and log|I + Sigma P| / 2, exact at Sigma = 0.

    Each diagonal P is a row of ``precision`` (K, D); ``root`` holds the outer products of the roots
    of P, (K, D, D). The adjoint follows from dB = -B (dSigma + dP^-1) B.
    """

    @staticmethod
    def forward(cov: Tensor, precision: Tensor, root: Tensor) -> tuple[Tensor, Tensor]:
        scaled = root * cov[:, None]
        scaled.diagonal(dim1=-2, dim2=-1).add_(1)
        factor = cholesky(scaled, "I + Sigma P (last element: kernel, then pair of kernels)")
        half_log_det = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        return torch.cholesky_inverse(factor) * root, half_log_det

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: tuple[Tensor, ...]) -> None:
        ctx.save_for_backward(inputs[1], output[0])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_B: Tensor, d_half_log_det: Tensor) -> tuple[Tensor | None, ...]:
        precision, B = ctx.saved_tensors
        through_B = B @ symmetric(d_B) @ B
        scale = d_half_log_det[..., None] / 2
        d_cov = (scale[..., None] * B - through_B).sum(1)
        if not ctx.needs_input_grad[1]:
            return d_cov, None, None
        by_B, shrunk = (t.diagonal(dim1=-2, dim2=-1) / precision.square() for t in (through_B, B))
        return d_cov, (by_B + scale * (1 / precision - shrunk)).sum(0), None
