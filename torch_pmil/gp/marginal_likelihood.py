"""Marginal likelihood of a Gaussian process with the kernel of Eq. 5, and its gradient."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import cholesky


@torch.no_grad()
def negative_log_likelihood(
    inputs: Tensor, target: Tensor, log_parameters: Tensor
) -> tuple[float, Tensor]:
    r"""Negative log marginal likelihood of one output with zero prior mean, and its gradient.

    .. math::
        -\log p(y | X) = \tfrac12 y^\top K^{-1} y + \tfrac12 \log |K| + \tfrac{n}{2} \log 2 \pi,
        \qquad K = K_f + \sigma_\epsilon^2 I

    Both are closed forms of one Cholesky factor, without a graph.

    Args:
        inputs: (n, D).
        target: (n,).
        log_parameters: logarithms of the D lengthscales (roots of Lambda), the signal variance
            alpha^2 and the noise variance sigma_eps^2, (D + 2,), in units of the data.

    Returns:
        Nats, and the gradient in the log parameters, (D + 2,).

    Raises:
        NotPositiveDefiniteError: the Gram matrix has no Cholesky factor; nothing is added to its
            diagonal.

    Source: Rasmussen and Williams (2006), Eq. 2.30.

    Example:
        >>> x = torch.zeros(1, 1, dtype=torch.float64)
        >>> standard = torch.tensor([0.0, 0.0, -100.0], dtype=torch.float64)  # N(0, 1)
        >>> value, _ = negative_log_likelihood(x, x[0], standard)
        >>> value == math.log(2 * math.pi) / 2
        True
    """
    z, noise = (inputs - inputs.mean(0)) * torch.exp(-log_parameters[:-2]), log_parameters[-1].exp()
    squares = z.square()
    gram = _signal_gram(z, squares, log_parameters[-2])
    noisy = gram.clone()
    noisy.diagonal().add_(noise)
    factor = cholesky(noisy, "Gram matrix")
    beta = torch.cholesky_solve(target[:, None], factor)[:, 0]
    half_log_det = factor.diagonal().log().sum().item()
    value = (target @ beta).item() / 2 + half_log_det + len(target) / 2 * math.log(2 * math.pi)
    return value, _gradient(z, squares, gram, torch.cholesky_inverse(factor), beta, noise)


def _signal_gram(z: Tensor, squares: Tensor, log_signal: Tensor) -> Tensor:
    """Noise-free Gram matrix K_f at scaled inputs z (n, D)."""
    half = (squares.sum(-1) - log_signal) / 2
    return torch.addmm(half[:, None] + half, z, z.mT, beta=-1).exp_()


def _gradient(
    z: Tensor, squares: Tensor, gram: Tensor, inverse: Tensor, beta: Tensor, noise: Tensor
) -> Tensor:
    r"""Gradient dL/dtheta = tr((K^-1 - beta beta') dK/dtheta) / 2 in all log parameters.

    Source: Rasmussen and Williams (2006), Eq. 5.9.

    With W = (K^-1 - beta beta') ∘ K_f and its row sums r, the entry of a lengthscale is
    sum_ij W_ij (z_id - z_jd)^2 / 2 = r' z_d^2 - z_d' W z_d. ``inverse`` is overwritten.
    """
    W = inverse.addr_(beta, beta, alpha=-1)
    of_noise = noise * W.trace()
    W.mul_(gram)
    r = W.sum(-1)
    lengthscales = r @ squares - (z * (W @ z)).sum(0)
    return torch.cat([lengthscales, torch.stack([r.sum(), of_noise]) / 2])
