r"""Posteriors of Gaussian processes through m inducing inputs, where n data are too many.

In the fully independent training conditional (FITC; Snelson and Ghahramani 2006) data are
independent of each other given the values of the function at the inducing inputs z. With
:math:`q_i = k_i^\top K^{-1} k_i`, :math:`k_i = k(z, x_i)` and :math:`K = k(z, z)`,

.. math::
    \lambda_i &= \alpha^2 - q_i + \sigma^2, \qquad
    B = K + \sum_i k_i k_i^\top / \lambda_i, \\
    \mathrm E[f(x)] &= c + k(x, z)\,\beta, \qquad
    \beta = B^{-1} \sum_i k_i (y_i - c) / \lambda_i, \\
    \operatorname{var} f(x) &= \alpha^2 - k(x, z) \left(K^{-1} - B^{-1}\right) k(z, x).

This has the form of an exact posterior (Eqs. 6 and 7), so that the moments of Eqs. 14-18 are exact
for it too, at a cost that depends on m alone.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.checks import check_positive_entries, check_real, check_tensor, check_whole
from torch_pmil.gp.gaussian import cholesky, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion, check_data, joined
from torch_pmil.gp.kernel_pairs import gram


def sparse_posterior(
    inputs: Tensor,
    targets: Tensor,
    inducing: Tensor,
    lengthscales: Tensor,
    signal_variance: Tensor,
    noise_variance: Tensor,
    ridge: Tensor,
    offset: Tensor | float = 0.0,
) -> KernelExpansion:
    """FITC posterior given data: O(n m²) work, and an expansion of m terms.

    Args:
        inputs: (n, D).
        targets: (E, n).
        inducing: inducing inputs (m, D), or (E, m, D) where the outputs have inputs of their own.
        lengthscales, signal_variance, noise_variance, offset: as in :class:`KernelExpansion`.
        ridge: variance that is added to each value at the inducing inputs, (E,), in squared units
            of the targets. Inducing inputs that are near each other need some; its part of the
            signal variance limits how exact the posterior is.

    Raises:
        ValueError: shapes or dtypes do not fit, or an entry is out of range.
        NotPositiveDefiniteError: names the output whose Gram matrix has no Cholesky factor.

    Example:
        >>> x = torch.linspace(-3, 3, 300, dtype=torch.float64)[:, None]
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> model = x, x.mT.sin(), x[::27], one[None], one, 1e-4 * one, 1e-8 * one
        >>> f = sparse_posterior(*model)
        >>> f.inputs.shape, bool((f.mean(x) - x.sin()).abs().max() < 1e-2)
        (torch.Size([12, 1]), True)
    """
    check_data(inputs, targets, lengthscales, signal_variance, noise_variance, offset)
    _check_inducing(inducing, inputs, noise_variance, ridge)
    kernel = lengthscales, signal_variance
    between = gram(inducing, inducing, *kernel)
    between = between + torch.diag_embed(ridge[:, None].expand(between.shape[:-1]))
    factor = cholesky(between, "Gram matrix of the inducing inputs (element: output)")
    known = gram(inducing, inputs, *kernel)
    explained = torch.linalg.solve_triangular(factor, known, upper=False)  # (E, m, n)
    left_over = signal_variance[:, None] - explained.square().sum(1)
    roots = (left_over.clamp(min=0) + noise_variance[:, None]).sqrt()[:, None]  # (E, 1, n)
    scaled = explained / roots
    eye = torch.eye(between.shape[-1], dtype=inputs.dtype, device=inputs.device)
    name = "precision of the inducing values (element: output)"
    precision = cholesky(eye + scaled @ scaled.mT, name)
    offsets = torch.as_tensor(offset, dtype=targets.dtype, device=targets.device)
    centred = ((targets - offsets.reshape(-1, 1))[:, None] / roots).mT
    white = torch.cholesky_solve(scaled @ centred, precision)
    back = torch.linalg.solve_triangular(factor.mT, eye.expand_as(between), upper=True)
    inverse = symmetric(back @ (eye - torch.cholesky_inverse(precision)) @ back.mT)
    inducing, weights, inverse = joined(inducing, (back @ white)[..., 0], inverse)
    return KernelExpansion(inducing, weights, *kernel, inverse, noise_variance, offset)


def inducing_data(
    inputs: Tensor,
    lengthscales: Tensor,
    signal_variance: Tensor,
    noise_variance: Tensor,
    count: int,
) -> Tensor:
    r"""Inducing inputs, chosen greedily from the data, as indices (m,) in their order.

    Each choice lowers the trace of the conditional covariances of all data the most. The trace is
    divided by the noise variances and summed over the outputs. Half of it is what the evidence
    lower bound of a sparse posterior loses (Titsias 2009). The search ends early when only rounding
    errors are left.

    Args:
        inputs: (n, D); the work grows with n².
        lengthscales, signal_variance, noise_variance: as in :class:`KernelExpansion`.
        count: number of inducing inputs at most.

    Raises:
        ValueError: the count is less than one or more than the data.

    Example:
        >>> x = torch.tensor([[0.0], [0.1], [0.2], [5.0]]).double()
        >>> one = torch.ones(1).double()
        >>> inducing_data(x, one[None], one, 0.01 * one, 2)
        tensor([1, 3])
    """
    check_whole("count", count, 1, len(inputs))
    left_over = gram(inputs, inputs, lengthscales, signal_variance)  # (E, n, n)
    negligible = len(inputs) * torch.finfo(inputs.dtype).eps * signal_variance[:, None]
    chosen: list[int] = []
    for _ in range(count):
        variances = left_over.diagonal(dim1=1, dim2=2)
        gain = torch.linalg.vector_norm(left_over, dim=1).square() / variances.maximum(negligible)
        gain = (gain * (variances > negligible) / noise_variance[:, None]).sum(0)
        newest = int(gain.argmax())
        if not gain[newest] > 0:
            break
        column = left_over[:, :, newest].clone()
        scaled = column / column[:, newest, None].maximum(negligible)
        left_over.baddbmm_(scaled[:, :, None], column[:, None], alpha=-1)
        chosen.append(newest)
    return torch.tensor(chosen)


def _check_inducing(
    inducing: Tensor, inputs: Tensor, noise_variance: Tensor, ridge: Tensor
) -> None:
    check_real("inducing", inducing)
    check_tensor("ridge", ridge, (len(noise_variance),))
    own = (len(ridge),) if inducing.ndim == 3 else ()
    check_tensor("inducing", inducing, (*own, "m", inputs.shape[-1]))
    if not (ridge >= 0).all():
        raise ValueError(f"ridge must not be negative, got {ridge.min().item():.3g}")
    check_positive_entries("noise_variance of a sparse posterior", noise_variance)
