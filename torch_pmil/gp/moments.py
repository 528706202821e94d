"""The moments of a function of a Gaussian input."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of f(x) when x is Gaussian and f an expansion of E outputs.

    Args:
        mean: (*batch, E), in the units of the outputs.
        cov: (*batch, E, E).
        inv_cov_cross_cov: Sigma_x^-1 cov(x, f), (*batch, D, E): multiply by Sigma_x for the
            covariance itself, see :meth:`cross_cov`. It stays finite where Sigma_x is singular.
    """

    mean: Tensor  # (*batch, E)
    cov: Tensor  # (*batch, E, E)
    inv_cov_cross_cov: Tensor  # (*batch, D, E)

    @property
    def gaussian(self) -> Gaussian:
        """The Gaussian with this mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def unflatten(self, batch_shape: torch.Size) -> Moments:
        """These moments with the batch shape in place of their single batch dimension."""
        if len(batch_shape) == 1:
            return self
        flat = self.mean, self.cov, self.inv_cov_cross_cov
        return Moments(*(t.reshape(*batch_shape, *t.shape[1:]) for t in flat))

    def cross_cov(self, belief: Gaussian) -> Tensor:
        """Input-output covariance cov(x, f), (*batch, D, E).

        ``belief`` is the belief over x at which these moments were computed.
        """
        return belief.cov @ self.inv_cov_cross_cov
