r"""Moment matching with all its derivatives by the belief, from the same sums over the data.

For a Gaussian input a derivative by the covariance is half a second derivative by the mean (Price's theorem). Each integral
(:class:`GaussianIntegrals`) is a sum of terms :math:`W e^{-\nu^\top B \nu / 2}`, so its derivatives by the mean are the moments of
:math:`B \nu`:

.. math::
    \nabla s = B \sum W \nu, \qquad \nabla^2 s = B \Big(\sum W \nu \nu^\top\Big) B - s B

and the third, needed since :math:`\Sigma^{-1} \operatorname{cov}(x, f)` is itself the gradient of the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import torch
from torch import Tensor

from torch_pmil.exponential_sums import thin_products
from torch_pmil.gaussian import Gaussian
from torch_pmil.gaussian_integrals import GaussianIntegrals
from torch_pmil.kernel_expansion import KernelExpansion
from torch_pmil.moment_matching import Moments, combine, first_slope


@dataclass(frozen=True)
class MomentSums:
    """Sums over the data at N beliefs, from which the moments and their derivatives follow: a few kB a belief, whatever n.

    With W_ij the weighted Q_ij of a pair of outputs, w_i = beta_i q_i of a single one, and the terms of :class:`GaussianIntegrals`:

    Args:
        precision: B, (N, E + P, D, D).
        single: sum_i w_i [nu_i, 1], (N, E, D + 1).
        pair: sum_ij W_ij [nu_i, 1] [nu_j, 1]', (N, P, D + 1, D + 1).
        squares: (N, E + 2P, D, D), of each output sum_i w_i nu_i nu_i', then of each pair sum_ij W_ij nu_i nu_i', and with nu_j nu_j'.
        cubes: sum_i w_i nu_i nu_i nu_i, (N, E, D, D, D).
    """

    precision: Tensor
    single: Tensor
    pair: Tensor
    squares: Tensor
    cubes: Tensor

    @classmethod
    def of(cls, f: KernelExpansion, belief: Gaussian) -> MomentSums:
        """Without a graph. Raises as :meth:`GaussianIntegrals.of`."""
        integrals = GaussianIntegrals.of(f, belief)
        D, E, nu1, (w, z) = f.num_inputs, f.num_outputs, integrals.nu1, f.pair_weights
        w_nu1 = w * integrals.left[:, :, : D + 1]
        left_Q, Q_z = thin_products(integrals.left, integrals.right, w_nu1, z.mT.expand(len(nu1), -1, -1, -1), f.self_weights)
        left_Q_z = left_Q * z
        beta_q = f.weights * integrals.q
        row_sums, column_sums = w[:, 0] * Q_z.squeeze(-1), left_Q_z[:, :, D]
        squares, columns = integrals.squares.mT, nu1.mT
        return cls(
            precision=integrals.precision,
            single=beta_q @ columns,
            pair=left_Q_z @ columns[:, None],
            squares=(torch.cat([beta_q, row_sums, column_sums], 1) @ squares).unflatten(2, (D, D)),
            cubes=((beta_q[:, :, None] * nu1[:, None, :D]).flatten(1, 2) @ squares).view(-1, E, D, D, D),
        )

    @classmethod
    def concatenated(cls, sums: Sequence[MomentSums]) -> MomentSums:
        """Those of all beliefs, one after the other."""
        return cls(*(torch.cat([getattr(s, field.name) for s in sums]) for field in fields(cls)))

    def moments(self, f: KernelExpansion, observation_noise: bool) -> Moments:
        """As :func:`moment_match` gives them."""
        slope = first_slope(self.precision, self.single)
        return combine(f, self.single[..., -1], slope, self.pair[..., -1, -1], observation_noise)


class RecordedMoments:
    """:func:`moment_match` of one expansion without a graph, which keeps what its derivatives at all those beliefs are made of.

    Args:
        f: the expansion.
        observation_noise: as in :func:`moment_match`.
    """

    def __init__(self, f: KernelExpansion, observation_noise: bool = False) -> None:
        self.f, self.observation_noise = f, observation_noise
        self._record: list[tuple[Gaussian, MomentSums]] = []

    @torch.no_grad()
    def __call__(self, belief: Gaussian) -> Moments:
        """Moments at N beliefs, the same number in all calls."""
        sums = MomentSums.of(self.f, belief)
        self._record.append((belief, sums))
        return sums.moments(self.f, self.observation_noise)

    @cached_property
    def linearised(self) -> LinearisedMoments:
        """The moments at the beliefs of all T calls, (T, N), to first order around them."""
        beliefs, sums = zip(*self._record, strict=True)
        mean, cov = torch.stack([b.mean for b in beliefs]), torch.stack([b.cov for b in beliefs])
        return LinearisedMoments(self.f, MomentSums.concatenated(sums), Gaussian(mean, cov), self.observation_noise)


class LinearisedMoments:
    """Moments as functions of the belief, to first order around the N beliefs at which the sums were taken.

    Args:
        f: the expansion.
        sums: over its data.
        belief: where these were taken.
        observation_noise: as in :func:`moment_match`.
    """

    def __init__(self, f: KernelExpansion, sums: MomentSums, belief: Gaussian, observation_noise: bool) -> None:
        self.f, self.observation_noise = f, observation_noise
        self.point = belief.flat.flatten(0, -2)
        total, gradient, hessian, third = _derivatives(f, sums)
        slope = gradient[:, : f.num_outputs]
        self.values = torch.cat([total, slope.flatten(1)], 1)
        by_mean = torch.cat([gradient, hessian[:, : f.num_outputs].flatten(1, 2)], 1)
        by_cov = torch.cat([hessian, third.flatten(1, 2)], 1) / 2
        both = by_cov + by_cov.mT  # an entry of the triangle stands for two of the matrix
        both.diagonal(dim1=-2, dim2=-1).copy_(by_cov.diagonal(dim1=-2, dim2=-1))
        self.jacobian = Gaussian(by_mean, both).flat

    def __call__(self, belief: Gaussian) -> Moments:
        """At one or more copies of the beliefs of the expansion, (T, N, C): exact there, with exact derivatives."""
        E, P = self.f.num_outputs, len(self.f.products.first)
        change = belief.flat.reshape(len(self.point), -1, self.point.shape[-1]) - self.point[:, None]
        outputs = (self.values[:, None] + change @ self.jacobian.mT).flatten(0, 1)
        mean, second, slope = outputs.split([E, P, E * self.f.num_inputs], 1)
        return combine(self.f, mean, slope.unflatten(1, (E, -1)), second, self.observation_noise).unflatten(belief.batch_shape)


def _derivatives(f: KernelExpansion, sums: MomentSums) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Value (N, E + P), gradient (.., D) and Hessian (.., D, D) by the mean of all integrals; third derivatives of the single ones."""
    E, D, products = f.num_outputs, f.num_inputs, f.products
    B, (i_share, j_share) = sums.precision, products.shares
    own, of_i, of_j = sums.squares.split([E, len(products.first), len(products.first)], 1)
    first_pair = i_share * sums.pair[..., :D, D] + j_share * sums.pair[..., D, :D]
    mixed = i_share[:, :, None] * j_share[:, None] * sums.pair[..., :D, :D]
    own_pair = i_share[:, :, None] * i_share[:, None] * of_i + j_share[:, :, None] * j_share[:, None] * of_j
    second_pair = own_pair + mixed + mixed.mT
    total = torch.cat([sums.single[..., -1], sums.pair[..., -1, -1]], 1)
    gradient = (B @ torch.cat([sums.single[..., :-1], first_pair], 1)[..., None]).squeeze(-1)
    hessian = B @ torch.cat([own, second_pair], 1) @ B - total[..., None, None] * B
    return total, gradient, hessian, _third_derivative(B[:, :E], gradient[:, :E], sums.cubes)


def _third_derivative(B: Tensor, gradient: Tensor, cubes: Tensor) -> Tensor:
    """Of the single integrals by the mean, (N, E, D, D, D)."""
    raised = B[:, :, None] @ (B @ cubes.flatten(3)).unflatten(3, cubes.shape[3:]) @ B[:, :, None]
    product = gradient[..., :, None, None] * B[..., None, :, :]
    return raised - product - product.transpose(-3, -2) - product.transpose(-3, -1)
