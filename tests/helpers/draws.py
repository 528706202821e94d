"""Seeded random ingredients that several tests share, in float64."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion


class Draws:
    """A seeded source of tensors, beliefs and functions."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def normal(self, *shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=self.generator)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        share = torch.rand(*shape, dtype=torch.float64, generator=self.generator)
        return low + (high - low) * share

    def cov(self, *shape: int, scale: float = 0.3) -> Tensor:
        """Covariances (*shape, D) x D, positive definite; ``scale`` is about their variance."""
        root = self.normal(*shape, shape[-1])
        ridge = 0.1 * torch.eye(shape[-1], dtype=torch.float64)
        return scale * (root @ root.mT / shape[-1] + ridge)

    def belief(self, *shape: int, scale: float = 0.3) -> Gaussian:
        """Beliefs of mean (*shape,), the variable's dimension last."""
        return Gaussian(self.normal(*shape), self.cov(*shape, scale=scale))

    def gp(self, n: int, D: int, E: int) -> KernelExpansion:
        """A GP posterior of E outputs given n data."""
        return KernelExpansion.from_data(
            inputs=self.normal(n, D),
            targets=self.normal(E, n),
            lengthscales=self.uniform(0.7, 2.0, E, D),
            signal_variance=self.uniform(0.5, 2.0, E),
            noise_variance=self.uniform(0.01, 0.1, E),
            offset=self.normal(E),
        )

    def network(self, m: int, D: int, E: int) -> KernelExpansion:
        """An RBF network of m centres and E outputs."""
        one = torch.ones(E, dtype=torch.float64)
        centres, weights = self.normal(m, D), self.normal(E, m)
        return KernelExpansion(centres, weights, self.uniform(0.7, 2.0, E, D), one)
