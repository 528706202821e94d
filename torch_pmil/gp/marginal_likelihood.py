"""Marginal likelihood of a Gaussian process with the kernel of Eq. 5; its gradient in closed form.

==================  ========================================================================
paper symbol        name
==================  ========================================================================
Lambda              squared ``exp(log_parameters[:D])``, lengthscales in units of the inputs
alpha^2             ``exp(log_parameters[D])``, signal variance in squared units of the target
sigma_eps^2         ``exp(log_parameters[D + 1])``, noise variance in squared units of the target
==================  ========================================================================
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gp.gaussian import cholesky


def negative_log_likelihood(inputs: Tensor, target: Tensor, log_parameters: Tensor) -> Tensor:
    r"""Negative log marginal likelihood of one output with zero prior mean.

    .. math::
        -\log p(y | X) = \tfrac12 y^\top K^{-1} y + \tfrac12 \log |K| + \tfrac{n}{2} \log 2 \pi,
        \qquad K = K_f + \sigma_\epsilon^2 I

    The gradient is a closed form of the same Cholesky factor. There is no second derivative, and
    none with respect to the data.

    Args:
        inputs: (n, D).
        target: (n,).
        log_parameters: logarithms of the D lengthscales, the signal variance and the noise
            variance, (D + 2,).

    Returns:
        Nats, a scalar.

    Raises:
        NotPositiveDefiniteError: the Gram matrix has no Cholesky factor; nothing is added to its
            diagonal.

    Source: Rasmussen and Williams (2006), Eq. 2.30.

    Example:
        >>> x = torch.zeros(1, 1, dtype=torch.float64)
        >>> standard = torch.tensor([0.0, 0.0, -100.0], dtype=torch.float64)  # N(0, 1)
        >>> negative_log_likelihood(x, x[0], standard)  # log(2 pi) / 2
        tensor(0.9189, dtype=torch.float64)
    """
    return _NegativeLogLikelihood.apply(inputs, target, log_parameters)


class _NegativeLogLikelihood(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, inputs: Tensor, target: Tensor, log_parameters: Tensor) -> Tensor:
        log_lengthscales, (log_signal, log_noise) = log_parameters[:-2], log_parameters[-2:]
        z = (inputs - inputs.mean(0)) * torch.exp(-log_lengthscales)
        gram = _signal_gram(z, log_signal)
        noisy = gram.clone()
        noisy.diagonal().add_(log_noise.exp())
        factor = cholesky(noisy, "Gram matrix")
        beta = torch.cholesky_solve(target[:, None], factor)[:, 0]
        ctx.save_for_backward(_gradient(z, gram, torch.cholesky_inverse(factor), beta, log_noise))
        return (
            target @ beta / 2
            + factor.diagonal().log().sum()
            + len(target) / 2 * math.log(2 * math.pi)
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, None, Tensor]:
        (gradient,) = ctx.saved_tensors
        return None, None, grad * gradient


def _signal_gram(z: Tensor, log_signal: Tensor) -> Tensor:
    """Noise-free Gram matrix K_f at scaled inputs z (n, D)."""
    half = z.square().sum(-1) / 2 - log_signal / 2
    return torch.addmm(half[:, None] + half, z, z.mT, beta=-1).exp_()


def _gradient(z: Tensor, gram: Tensor, inverse: Tensor, beta: Tensor, log_noise: Tensor) -> Tensor:
    r"""Gradient dL/dtheta = tr((K^-1 - beta beta') dK/dtheta) / 2 in all log parameters.

    Source: Rasmussen and Williams (2006), Eq. 5.9.

    With W = (K^-1 - beta beta') ∘ K_f and its row sums r, the entry of a lengthscale is
    sum_ij W_ij (z_id - z_jd)^2 / 2 = r' z_d^2 - z_d' W z_d, without an array of shape (n, n, D).
    Overwrites ``inverse``.
    """
    W = inverse.addr_(beta, beta, alpha=-1)
    noise = log_noise.exp() * W.trace() / 2
    W.mul_(gram)
    r = W.sum(-1)
    lengthscales = r @ z.square() - (z * (W @ z)).sum(0)
    return torch.cat([lengthscales, torch.stack([r.sum() / 2, noise])])
