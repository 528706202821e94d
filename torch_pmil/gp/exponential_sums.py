r"""Sums of exponentials over all pairs of data: the O(n^2) work of moment matching.

It is done in pieces that stay in the cache.
"""

from __future__ import annotations

from itertools import repeat
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

# numbers in the array that a thread works on at a time: half a megabyte, which the level-2 cache
# holds beside the rest
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
    own = 0 if M is None else len(M)
    largest = max(1, CACHED_NUMBERS // (n * n)) * torch.get_num_threads()
    pieces = _pieces(N, P, own, largest)
    sizes = [size for size, _ in pieces]
    operands = zip(*(t.flatten(0, 1).split(sizes) for t in (left.mT, right, w, z)), strict=True)
    products = [
        _multiply(
            rows,
            columns,
            w_part,
            z_part,
            None if M is None or first is None else M[first : first + size],
        )
        for (rows, columns, w_part, z_part), (size, first) in zip(operands, pieces, strict=True)
    ]
    wQ, Qz = (torch.cat(parts).unflatten(0, (N, P)) for parts in zip(*products, strict=True))
    return wQ, Qz


def _pieces(N: int, P: int, own: int, largest: int) -> list[tuple[int, int | None]]:
    """Sizes of the batches of Q that are worked on together, each with its first element of M.

    At most ``largest`` Q make a batch. The first ``own`` of every belief's P pairs have factors M;
    the element is None for the other pairs.
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
    tiles = zip(
        left.split(rows, 1),
        w.split(rows, 2),
        repeat(None) if M is None else M.split(rows, 1),
        strict=False,
    )
    wQ, Qz = zip(
        *(
            _products_with(torch.bmm(rows_of_left, right), w_rows, z, M_rows)
            for rows_of_left, w_rows, M_rows in tiles
        ),
        strict=True,
    )
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

    Its gradient keeps thin products instead of n^2 numbers.

    Arguments as in :func:`pairwise_kernel_sums`, but with a single row w and z of each pair, (P, 1,
    n) or (N, P, 1, n); the entry ``one`` of every l_i and the last of every r_j must be 1.
    """

    @staticmethod
    def forward(
        ctx: Any,
        left: Tensor,
        right: Tensor,
        w: Tensor,
        z: Tensor,
        M: Tensor | None,
        one: int,
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
        d_w = (
            (scale * Q_right.mT[..., -1:, :]).sum_to_size(w.shape)
            if ctx.needs_input_grad[2]
            else None
        )
        d_z = (
            (scale * left_Q[..., ctx.one : ctx.one + 1, :]).sum_to_size(z.shape)
            if ctx.needs_input_grad[3]
            else None
        )
        d_M = _sum_of_Q(left, right, w, z, scale, ctx.own) if ctx.needs_input_grad[4] else None
        return d_left, d_right, d_w, d_z, d_M, None


def _sum_of_Q(left: Tensor, right: Tensor, w: Tensor, z: Tensor, scale: Tensor, own: int) -> Tensor:
    """Sum over beliefs of scale w_i z_j exp(l_i . r_j) for the first ``own`` pairs, (own, n, n)."""
    beliefs = zip(*(t[:, :own].unbind(0) for t in (left, right, scale)), strict=True)
    return (
        w[:own].mT
        * z[:own]
        * sum(factor * (rows.mT @ columns).exp() for rows, columns, factor in beliefs)
    )
