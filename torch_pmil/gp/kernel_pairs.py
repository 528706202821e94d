"""Kernels of several outputs: values at pairs of points, and the pairs that moments integrate."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


def gram(x: Tensor, y: Tensor, lengthscales: Tensor, signal_variance: Tensor) -> Tensor:
    r"""Values :math:`k_a(x_i, y_j)` of the kernel of Eq. 5, (E, n, m), by one matrix product.

    It loses digits far from zero, so that points are taken around the mean of ``y``.

    Args:
        x: (n, D), or (E, n, D) where the outputs have points of their own.
        y: (m, D) or (E, m, D).
        lengthscales: (E, D).
        signal_variance: (E,).

    Example:
        >>> points = torch.tensor([[0.0], [2.0]])
        >>> gram(points, points[:1], torch.ones(1, 1), torch.ones(1)).flatten()
        tensor([1.0000, 0.1353])
    """
    centre = y.mean(-2, keepdim=True)
    scaled_x, scaled_y = ((points - centre) / lengthscales[:, None, :] for points in (x, y))
    half_x, half_y = (each.square().sum(-1, keepdim=True) / -2 for each in (scaled_x, scaled_y))
    with_signal = half_x + signal_variance.log()[:, None, None]
    left = torch.cat([scaled_x, with_signal, torch.ones_like(half_x)], -1)
    return torch.exp(left @ torch.cat([scaled_y, torch.ones_like(half_y), half_y], -1).mT)


@dataclass(frozen=True, eq=False)
class KernelPairs:
    """The E kernels and their P = E(E+1)/2 products, those of each with itself first.

    Args:
        first, second: the two outputs of each product, (P,).
        position: index of the product of outputs a and b among the products, (E * E,).
        precision: summed precisions, (E + P, D).
        root: outer products of the square roots of the precisions, (E + P, D, D).
        constant, factor, integrals: ``constant + factor * B[integrals]``, (E + 3P, D, D), are the
            quadratic forms of one belief: of x_i for the kernels; of x_i, x_j and both for the
            products.
        log_factor: log alpha^2 of the kernels, then of both factors of each product, (E + 2P,).
        minus_log_det: adds -log|I + Sigma P| / 2 of each integral to ``log_factor``, (E + 2P,
            E + P).
    """

    first: Tensor
    second: Tensor
    position: Tensor
    precision: Tensor
    root: Tensor
    constant: Tensor
    factor: Tensor
    integrals: Tensor
    log_factor: Tensor
    minus_log_det: Tensor

    @classmethod
    def of(cls, precision: Tensor, log_signal_variance: Tensor) -> KernelPairs:
        """Pairs of kernels with the diagonals Lambda_a^-1, (E, D), and log alpha_a^2, (E,)."""
        E, D = precision.shape
        outputs = torch.arange(E, device=precision.device)
        a, b = torch.triu_indices(E, E, offset=1, device=precision.device)
        first, second = torch.cat([outputs, a]), torch.cat([outputs, b])
        P = len(first)
        position = torch.empty(E, E, dtype=torch.long, device=precision.device)
        position[first, second] = position[second, first] = torch.arange(P, device=precision.device)
        factors = torch.stack([precision[first], precision[second]])  # (2, P, D)
        shares = factors / factors.sum(0)
        precisions = torch.cat([precision, factors.sum(0)])
        distance = torch.diag_embed(factors[0] * shares[1])  # (Lambda_a + Lambda_b)^-1
        half_own = _outer(shares, shares).flatten(0, 1) / -2
        integrals = torch.arange(E + P, device=precision.device)
        none, half = precision.new_zeros(E, D, D), precision.new_full((E, D, D), -0.5)
        return cls(
            first=first,
            second=second,
            position=position.flatten(),
            precision=precisions,
            root=_outer(precisions.sqrt(), precisions.sqrt()),
            constant=torch.cat([none, distance / -2, distance / -2, distance]),
            factor=torch.cat([half, half_own, -_outer(*shares)]),
            integrals=torch.cat([integrals, integrals[E:], integrals[E:]]),
            log_factor=torch.cat(
                [log_signal_variance, log_signal_variance[first], log_signal_variance[second]]
            ),
            minus_log_det=-torch.eye(E + 2 * P, E + P).to(precision),
        )


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return a[..., :, None] * b[..., None, :]
