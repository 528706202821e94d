"""Models of GPyTorch that several tests share."""

from __future__ import annotations

import gpytorch
import torch
from gpytorch.kernels import Kernel, RBFKernel, ScaleKernel
from gpytorch.likelihoods import GaussianLikelihood, Likelihood
from gpytorch.means import Mean, ZeroMean
from torch import Tensor


class ExactGP(gpytorch.models.ExactGP):
    """A GP of any mean and kernel."""

    def __init__(
        self, inputs: Tensor, targets: Tensor, mean: Mean, kernel: Kernel, likelihood: Likelihood
    ) -> None:
        super().__init__(inputs, targets, likelihood)
        self.mean_module, self.covar_module = mean, kernel

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


def exact_gp_of(
    inputs: Tensor,
    targets: Tensor,
    mean: type[Mean] = ZeroMean,
    ard: bool = True,
    kernel: Kernel | None = None,
    **likelihood: object,
) -> ExactGP:
    """A GP of outputs (*E, n), by default with a scaled RBF kernel, in float32."""
    size = torch.Size(targets.shape[:-1])
    rbf = RBFKernel(ard_num_dims=inputs.shape[-1] if ard else None, batch_shape=size)
    kernel = kernel or ScaleKernel(rbf, batch_shape=size)
    noise = GaussianLikelihood(batch_shape=size, **likelihood)
    return ExactGP(inputs, targets, mean(batch_shape=size), kernel, noise)
