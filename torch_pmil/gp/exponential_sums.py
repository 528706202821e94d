r"""Sums of exponentials over all pairs of data, the O(n^2) work of moment matching, by caches."""

from __future__ import annotations

from itertools import repeat
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

# a thread works on so many numbers at a time: half a megabyte, which fits into a level-2 cache
CACHED_NUMBERS = 2**16


def pairwise_kernel_sums(
    left: Tensor, right: Tensor, w: Tensor, z: Tensor, M: Tensor | None
) -> tuple[Tensor, Tensor]:
    r"""Products w Q and Q z of thin matrices with :math:`Q_{ij} = \exp(l_i^\top r_j)`.

    Args:
        left, right: (N, P, d, n), for N beliefs and P pairs of outputs.
        w: rows that multiply from the left, (N, P, k, n).
        z: columns that multiply from the right, (N, P, n, k').
        M: factors of the elements of Q for the first pairs, (E, n, n), or None.

    Returns:
        w Q, (N, P, k, n), and Q z, (N, P, n, k').
    """
    N, P, _, n = left.shape
    largest = max(1, CACHED_NUMBERS // (n * n)) * torch.get_num_threads()
    pieces = _pieces(N, P, 0 if M is None else len(M), largest)
    sizes = [size for size, _ in pieces]
    operands = [t.flatten(0, 1).split(sizes) for t in (left.mT, right, w, z)]
    factors = [
        None if M is None or first is None else M[first : first + size] for size, first in pieces
    ]
    products = [_multiply(*piece) for piece in zip(*operands, factors, strict=True)]
    wQ, Qz = (torch.cat(parts).unflatten(0, (N, P)) for parts in zip(*products, strict=True))
    return wQ, Qz


def _pieces(N: int, P: int, own: int, largest: int) -> list[tuple[int, int | None]]:
    """Sizes of batches of at most ``largest`` Q, each with its first element of M.

    The first ``own`` of every belief's P pairs have factors M; for the others it is None.
    """
    if own == 0:
        return [(min(largest, N * P - start), None) for start in range(0, N * P, largest)]
    with_M = [(min(largest, own - start), start) for start in range(0, own, largest)]
    without = [(min(largest, P - start), None) for start in range(own, P, largest)]
    return [*with_M, *without] * N


def _multiply(
    left: Tensor, right: Tensor, w: Tensor, z: Tensor, M: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Products w Q and Q z of a few Q, by blocks of rows where one Q is larger than the cache."""
    n = right.shape[-1]
    if n * n <= 4 * CACHED_NUMBERS:
        return _products_with(torch.bmm(left, right), w, z, M)
    rows = max(1, 2 * CACHED_NUMBERS // n)
    of_M = repeat(None) if M is None else M.split(rows, 1)
    tiles = zip(left.split(rows, 1), w.split(rows, 2), of_M, strict=False)
    products = [
        _products_with(torch.bmm(left_rows, right), w_rows, z, M_rows)
        for left_rows, w_rows, M_rows in tiles
    ]
    wQ, Qz = zip(*products, strict=True)
    return torch.stack(wQ).sum(0), torch.cat(Qz, 1)


def _products_with(
    exponents: Tensor, w: Tensor, z: Tensor, M: Tensor | None
) -> tuple[Tensor, Tensor]:
    Q = exponents.exp_()
    if M is not None:
        Q.mul_(M)
    return torch.bmm(w, Q), torch.bmm(Q, z)


class ExponentialSum(torch.autograd.Function):
    r"""The sum S = sum_ij w_i M_ij z_j exp(l_i . r_j) for every belief and pair, (N, P).

    For its gradient it keeps thin products instead of n^2 numbers.

    Arguments are as in :func:`pairwise_kernel_sums`, with one row w and z for each pair, (P, 1, n)
    or (N, P, 1, n). Entry ``one`` of every l_i and the last entry of every r_j must be 1.
    """

    @staticmethod
    def forward(
        ctx: Any, left: Tensor, right: Tensor, w: Tensor, z: Tensor, M: Tensor | None, one: int
    ) -> Tensor:
        left_Q, Q_right = pairwise_kernel_sums(left, right, w * left, (z * right).mT, M)
        ctx.one, ctx.own = one, 0 if M is None else len(M)
        ctx.save_for_backward(left, right, w, z, left_Q, Q_right)
        return (z[..., 0, :] * left_Q[..., one, :]).sum(-1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        left, right, w, z, left_Q, Q_right = ctx.saved_tensors
        scale = grad[..., None, None]
        d_left, d_right = w * (scale * Q_right.mT), z * (scale * left_Q)
        d_w = d_z = d_M = None
        if ctx.needs_input_grad[2]:
            d_w = (scale * Q_right.mT[..., -1:, :]).sum_to_size(w.shape)
        if ctx.needs_input_grad[3]:
            d_z = (scale * left_Q[..., ctx.one : ctx.one + 1, :]).sum_to_size(z.shape)
        if ctx.needs_input_grad[4]:
            d_M = _sum_of_Q(left, right, w, z, scale, ctx.own)
        return d_left, d_right, d_w, d_z, d_M, None


def _sum_of_Q(left: Tensor, right: Tensor, w: Tensor, z: Tensor, scale: Tensor, own: int) -> Tensor:
    """Sum over beliefs of scale w_i z_j exp(l_i . r_j) for the first ``own`` pairs, (own, n, n)."""
    beliefs = zip(*(t[:, :own].unbind(0) for t in (left, right, scale)), strict=True)
    total = sum(factor * (rows.mT @ columns).exp() for rows, columns, factor in beliefs)
    return w[:own].mT * z[:own] * total
