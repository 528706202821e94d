r"""The saturating cost of a point and its closed-form expectation over a Gaussian (Eq. 28).

Both count the distance from the target in widths: :math:`r = R(x - x_{\text{target}})` with
:math:`R^\top R = W / \sigma^2`.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import NEGLIGIBLE, Gaussian, check_belief, cholesky


def saturating_cost(residual: Tensor) -> Tensor:
    r"""Saturating cost (Eq. 28) from 0 at the target to 1 far from it, without unit.

    .. math:: 1 - \exp(-\tfrac12 \|r\|^2)

    Args:
        residual: distances from the target in widths, (*batch, K).

    Returns:
        Costs, (*batch).

    Example:
        >>> saturating_cost(torch.tensor([[0.0, 0.0], [3.0, 4.0]]))
        tensor([0.0000, 1.0000])
    """
    return 1 - torch.exp(-residual.square().sum(-1) / 2)


def expected_saturating_cost(residual: Gaussian) -> Tensor:
    r"""Expectation of :func:`saturating_cost` over a residual of N(m, S) (Eq. 28).

    .. math:: 1 - |I + S|^{-1/2} \exp\left(-\tfrac12 m^\top (I + S)^{-1} m\right)

    No jitter is needed: the eigenvalues of I + S are at least 1. A singular S must not exceed about
    1e15, where rounding swallows the I.

    Args:
        residual: belief over the distances from the target in widths, mean (*batch, K).

    Returns:
        Expected costs, (*batch), between 0 and 1, without unit.

    Raises:
        ValueError: the mean is not finite, or a dtype is not a float.
        NotPositiveDefiniteError: an S is not finite, not symmetric, or clearly not positive
            semi-definite; the message names the batch element.

    Source: Deisenroth and Rasmussen (2011), Eqs. 24 and 25.

    Example:
        >>> expected_saturating_cost(Gaussian(torch.zeros(1), torch.tensor([[3.0]])))
        tensor(0.5000)
    """
    check_belief(residual, "residual", floor=NEGLIGIBLE)
    I_plus_S = residual.cov + torch.eye(residual.dim).to(residual.cov)
    L = cholesky(I_plus_S, "identity plus covariance of the residual")
    white = torch.linalg.solve_triangular(L, residual.mean[..., None], upper=False)
    half_log_det = L.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    return 1 - torch.exp(-white.square().sum((-2, -1)) / 2 - half_log_det)
