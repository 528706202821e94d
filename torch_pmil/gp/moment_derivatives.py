r"""Moment matching with all its derivatives by the belief, from sums over the data.

For a Gaussian input a derivative by the covariance is half a second derivative by the mean (Price's
theorem). Each integral (:class:`GaussianIntegrals`) is a sum of terms :math:`W e^{-\nu^\top B \nu /
2}`, so its derivatives by the mean are the moments of :math:`B \nu`:

.. math::
    \nabla s = B \sum W \nu, \qquad \nabla^2 s = B \Big(\sum W \nu \nu^\top\Big) B - s B

The third derivative follows in the same way. It is needed since :math:`\Sigma^{-1}
\operatorname{cov}(x, f)` is itself the gradient of the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TypeVar

import torch
from torch import Tensor

from torch_pmil.gp.exponential_sums import pairwise_kernel_sums, products_for_gradient
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.gaussian_integrals import GaussianIntegrals, centred
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_matching import combine, first_slope
from torch_pmil.gp.moments import Moments

Part = TypeVar("Part", "MomentTerms", "MomentSums")
# numbers of arrays as long as the data that are kept before they are summed: half a megabyte
KEPT_NUMBERS = 2**16


class RecordedMoments:
    """:func:`moment_match` without a graph, which keeps what the derivatives at its beliefs need.

    Args:
        f: the expansion whose moments are computed.
        observation_noise: as in :func:`moment_match`.
        keep_products: whether to keep the ``products`` of :func:`moment_match`, for gradients in
            the expansion itself.
    """

    def __init__(
        self, f: KernelExpansion, observation_noise: bool = False, keep_products: bool = False
    ) -> None:
        self.f, self.observation_noise, self.keep_products = f, observation_noise, keep_products
        self._kept: list[tuple[Tensor, Tensor]] = []
        self._sums: list[MomentSums] = []
        self._pending: list[MomentTerms] = []

    @torch.no_grad()
    def __call__(self, belief: Gaussian) -> Moments:
        """Moments at N beliefs; N must be the same in all calls."""
        integrals = GaussianIntegrals.of(self.f, belief)
        if self.keep_products:
            whole = products_for_gradient(
                integrals.left, integrals.right, *self.f.pair_weights, self.f.self_weights
            )
            self._kept.append(whole)
            thin = whole[0][:, :, :-1], whole[1][..., -1:]
        else:
            thin = MomentTerms.needed(self.f, integrals)
        terms, moments = MomentTerms.at(self.f, belief, integrals, thin, self.observation_noise)
        self._pending.append(terms)
        if len(self._pending) * terms.left.numel() > KEPT_NUMBERS:
            self._sum_up()
        return moments

    def _sum_up(self) -> None:
        if self._pending:
            self._sums.append(MomentSums.of(self.f, _concatenated(self._pending)))
            self._pending = []

    @cached_property
    def products(self) -> tuple[Tensor, Tensor]:
        """The kept ``products`` of :func:`moment_match` at the T N beliefs of all T calls."""
        left_Q, Q_right = (torch.cat(parts) for parts in zip(*self._kept, strict=True))
        return left_Q, Q_right

    @cached_property
    def derivatives(self) -> MomentDerivatives:
        """Moments at the T N beliefs of all T calls, and their Jacobian in these beliefs."""
        self._sum_up()
        return MomentDerivatives(self.f, _concatenated(self._sums), self.observation_noise)


@dataclass(frozen=True, eq=False)
class MomentTerms:
    """Intermediate results of moment matching at N beliefs: arrays as long as the data.

    Args:
        mean: means of the beliefs, (N, D).
        precision: B of :class:`GaussianIntegrals`, (N, E + P, D, D).
        beta_q: beta_i q_i of each output, (N, E, n).
        left: sum_i w_i [nu_i, 1] Q_ij z_j of each pair of outputs, (N, P, D + 1, n).
        right: sum_j w_i Q_ij z_j, (N, P, n).
    """

    mean: Tensor
    precision: Tensor
    beta_q: Tensor
    left: Tensor
    right: Tensor

    @staticmethod
    def needed(f: KernelExpansion, integrals: GaussianIntegrals) -> tuple[Tensor, Tensor]:
        """Sums sum_i w_i [nu_i, 1] Q_ij, (N, P, D + 1, n), and sum_j Q_ij z_j, (N, P, n, 1)."""
        w, z = f.pair_weights
        columns = z.mT.expand(len(integrals.nu1), -1, -1, -1)
        return pairwise_kernel_sums(
            integrals.left, integrals.right, w * integrals.left[:, :, :-1], columns, f.self_weights
        )

    @classmethod
    def at(
        cls,
        f: KernelExpansion,
        belief: Gaussian,
        integrals: GaussianIntegrals,
        thin: tuple[Tensor, Tensor],
        observation_noise: bool,
    ) -> tuple[MomentTerms, Moments]:
        """Terms and moments at N beliefs, from the two sums ``thin`` that :meth:`needed` gives.

        The moments are those of :func:`moment_match`.
        """
        (w, z), nu1, (left_Q, Q_z) = f.pair_weights, integrals.nu1, thin
        beta_q = f.weights * integrals.q
        row_sums = w.squeeze(-2) * Q_z.squeeze(-1)
        single, second = beta_q @ nu1.mT, (w @ Q_z).flatten(1)
        moments = combine(
            f, single[..., -1], first_slope(integrals.precision, single), second, observation_noise
        )
        return cls(belief.mean, integrals.precision, beta_q, left_Q * z, row_sums), moments


@dataclass(frozen=True, eq=False)
class MomentSums:
    """Sums over the data at N beliefs, from which the moments and their derivatives follow.

    They take a few kB a belief, whatever n. W_ij is the weighted Q_ij of a pair of outputs, w_i =
    beta_i q_i the weight of a single one; the other symbols are those of
    :class:`GaussianIntegrals`.

    Args:
        precision: B, (N, E + P, D, D).
        single: sum_i w_i [nu_i, 1], (N, E, D + 1).
        pair: sum_ij W_ij [nu_i, 1] [nu_j, 1]', (N, P, D + 1, D + 1).
        squares: sum_i w_i nu_i nu_i' of each output, then of each pair sum_ij W_ij nu_i nu_i', then
            sum_ij W_ij nu_j nu_j', (N, E + 2P, D, D).
        cubes: sum_i w_i nu_i nu_i nu_i, (N, E, D, D, D).
    """

    precision: Tensor
    single: Tensor
    pair: Tensor
    squares: Tensor
    cubes: Tensor

    @classmethod
    def of(cls, f: KernelExpansion, terms: MomentTerms) -> MomentSums:
        """Sums over the data of the terms at N beliefs."""
        D, E = f.num_inputs, f.num_outputs
        nu1, squares = centred(f, terms.mean)
        weighted_nu = (terms.beta_q[:, :, None] * nu1[:, None, :D]).flatten(1, 2)
        return cls(
            precision=terms.precision,
            single=terms.beta_q @ nu1.mT,
            pair=terms.left @ nu1[:, None].mT,
            squares=(
                torch.cat([terms.beta_q, terms.right, terms.left[:, :, D]], 1) @ squares.mT
            ).unflatten(2, (D, D)),
            cubes=(weighted_nu @ squares.mT).view(-1, E, D, D, D),
        )


def _concatenated(parts: Sequence[Part]) -> Part:
    """The parts' fields, concatenated along the beliefs."""
    kind = type(parts[0])
    return kind(
        *(torch.cat([getattr(part, field.name) for part in parts]) for field in fields(kind))
    )


class MomentDerivatives:
    """Moments at N beliefs and their Jacobian in these beliefs.

    Args:
        f: the expansion whose moments they are.
        sums: its sums over the data at the beliefs.
        observation_noise: as in :func:`moment_match`.
    """

    def __init__(self, f: KernelExpansion, sums: MomentSums, observation_noise: bool) -> None:
        self.f = f
        total, gradient, hessian, third = _derivatives(f, sums)
        slope = gradient[:, : f.num_outputs]
        self.mean = total[:, : f.num_outputs]  # without the offset
        self.moments = combine(f, self.mean, slope, total[:, f.num_outputs :], observation_noise)
        by_mean = torch.cat([gradient, hessian[:, : f.num_outputs].flatten(1, 2)], 1)
        by_cov = torch.cat([hessian, third.flatten(1, 2)], 1) / 2
        both = by_cov + by_cov.mT  # an entry of the triangle stands for two of the matrix
        both.diagonal(dim1=-2, dim2=-1).copy_(by_cov.diagonal(dim1=-2, dim2=-1))
        self.jacobian = Gaussian(by_mean, both).flat

    def adjoint(
        self, d_mean: Tensor, d_cov: Tensor, d_inv_cov_cross_cov: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Cotangents of the beliefs, (N, C, D) and (N, C, D, D), from C cotangents of the moments.

        Cotangents of covariances are symmetric.
        """
        d_single = d_mean - 2 * (d_cov @ self.mean[:, None, :, None]).squeeze(-1)
        first, second = self.f.pairs.first, self.f.pairs.second
        d_second = d_cov[..., first, second] * torch.where(first == second, 1.0, 2.0)
        d_outputs = torch.cat([d_single, d_second, d_inv_cov_cross_cov.mT.flatten(-2)], -1)
        return Gaussian.cotangent_from_flat(d_outputs @ self.jacobian, self.f.num_inputs)


def _derivatives(f: KernelExpansion, sums: MomentSums) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Value (N, E + P), gradient (.., D) and Hessian (.., D, D) by the mean of all integrals.

    The last result is the third derivative of the E single integrals, (N, E, D, D, D).
    """
    E, D, P = f.num_outputs, f.num_inputs, len(f.pairs.first)
    B, (i_share, j_share) = sums.precision, f.pairs.shares
    own, of_i, of_j = sums.squares.split([E, P, P], 1)
    first_pair = i_share * sums.pair[..., :D, D] + j_share * sums.pair[..., D, :D]
    mixed = i_share[:, :, None] * j_share[:, None] * sums.pair[..., :D, :D]
    own_pair = (
        i_share[:, :, None] * i_share[:, None] * of_i
        + j_share[:, :, None] * j_share[:, None] * of_j
    )
    second_pair = own_pair + mixed + mixed.mT
    total = torch.cat([sums.single[..., -1], sums.pair[..., -1, -1]], 1)
    gradient = (B @ torch.cat([sums.single[..., :-1], first_pair], 1)[..., None]).squeeze(-1)
    hessian = B @ torch.cat([own, second_pair], 1) @ B - total[..., None, None] * B
    return total, gradient, hessian, _third_derivative(B[:, :E], gradient[:, :E], sums.cubes)


def _third_derivative(B: Tensor, gradient: Tensor, cubes: Tensor) -> Tensor:
    """Third derivative of the single integrals by the mean, (N, E, D, D, D)."""
    raised = B[:, :, None] @ (B @ cubes.flatten(3)).unflatten(3, cubes.shape[3:]) @ B[:, :, None]
    product = gradient[..., :, None, None] * B[..., None, :, :]
    return raised - product - product.transpose(-3, -2) - product.transpose(-3, -1)
