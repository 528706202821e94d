"""Moments of a Gaussian process at a Gaussian input, from samples of the input."""

from __future__ import annotations

import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import Gaussian

CHUNK = 2**14  # samples that are worked on together
Estimate = tuple[Tensor, Tensor]  # and its standard error


def sampled_moments(
    inputs: Tensor,
    targets: Tensor,
    lengthscales: Tensor,
    signal: Tensor,
    noise: Tensor,
    belief: Gaussian,
    count: int,
    draws: Draws,
) -> tuple[Estimate, Estimate]:
    """Mean (E,) and covariance (E, E) by the law of total variance, each with its standard error.

    Data and hyper-parameters are those of ``KernelExpansion.from_data``. The posterior at a sample
    comes from Cholesky factors of the Gram matrices alone.
    """
    posteriors = [
        _Posterior(inputs, *one) for one in zip(targets, lengthscales, signal, noise, strict=True)
    ]
    values, vectors = torch.linalg.eigh(belief.cov)
    root = vectors * values.clamp(min=0).sqrt()
    means, variances = [], []
    for start in range(0, count, CHUNK):
        white = draws.normal(min(CHUNK, count - start), belief.dim)
        at = [posterior.at(belief.mean + white @ root.mT) for posterior in posteriors]
        means.append(torch.stack([mean for mean, _ in at], -1))
        variances.append(torch.stack([variance for _, variance in at], -1))
    samples = torch.cat(means)
    mean = samples.mean(0)
    centred = samples - mean
    products = centred[:, :, None] * centred[:, None] + torch.diag_embed(torch.cat(variances))
    error = count**0.5
    return (mean, samples.std(0) / error), (products.mean(0), products.std(0) / error)


class _Posterior:
    """One output given its data."""

    def __init__(
        self, inputs: Tensor, targets: Tensor, lengthscales: Tensor, signal: Tensor, noise: Tensor
    ) -> None:
        self.inputs, self.lengthscales, self.signal = inputs, lengthscales, signal
        self.factor = torch.linalg.cholesky(
            self._kernel(inputs) + noise * torch.eye(len(inputs), dtype=inputs.dtype)
        )
        self.weights = torch.cholesky_solve(targets[:, None], self.factor)[:, 0]

    def _kernel(self, at: Tensor) -> Tensor:
        scaled = at / self.lengthscales, self.inputs / self.lengthscales
        apart = torch.cdist(*scaled, compute_mode="donot_use_mm_for_euclid_dist")
        return self.signal * (-apart.square() / 2).exp()

    def at(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Means and variances at inputs (N, D), each (N,)."""
        kernel = self._kernel(inputs)
        explained = torch.linalg.solve_triangular(self.factor, kernel.mT, upper=False)
        return kernel @ self.weights, self.signal - explained.square().sum(0)
