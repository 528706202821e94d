"""Weighted sums of squared exponentials: what a Gaussian process's posterior mean and an RBF network have in common."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import gpytorch
import torch
from gpytorch.kernels import RBFKernel, ScaleKernel
from gpytorch.means import ConstantMean, ZeroMean
from torch import Tensor

from torch_pmil.gaussian import cholesky


@dataclass(frozen=True)
class Products:
    """Which kernels moment matching integrates: the E single ones, then the products of two, of each output with itself first.

    Args:
        precision: summed precisions, (K, D), K = E + E(E+1)/2.
        first, second: the two outputs of each product, (K - E,).
        factors: output of every row term, then of every column term, (2K - E,).
        integrals: integral to which each of those belongs, (2K - E,).
        position: where the product of outputs a and b stands among the products, (E, E).
    """

    precision: Tensor
    first: Tensor
    second: Tensor
    factors: Tensor
    integrals: Tensor
    position: Tensor

    @classmethod
    def of(cls, precision: Tensor) -> Products:
        """Built from the diagonals of Lambda_a^-1, (E, D)."""
        E = len(precision)
        outputs = torch.arange(E, device=precision.device)
        a, b = torch.triu_indices(E, E, offset=1, device=precision.device)
        first, second = torch.cat([outputs, a]), torch.cat([outputs, b])
        position = torch.empty(E, E, dtype=torch.long, device=precision.device)
        position[first, second] = position[second, first] = torch.arange(len(first), device=precision.device)
        return cls(
            precision=torch.cat([precision, precision[first] + precision[second]]),
            first=first,
            second=second,
            factors=torch.cat([outputs, first, second]),
            integrals=torch.cat([outputs, E + position[first, second], E + position[first, second]]),
            position=position,
        )


@dataclass(frozen=True)
class KernelExpansion:
    r"""E functions :math:`f_a(x) = c_a + \sum_i \beta_{ai} k_a(x, x_i)` with the kernel of Eq. 5.

    .. math:: k_a(x, x') = \alpha_a^2 \exp\left(-\tfrac12 (x - x')^\top \Lambda_a^{-1} (x - x')\right)

    A GP posterior has :math:`\beta_a = K_a^{-1} (y_a - c_a)` and the inverse Gram matrix (which holds the noise); an RBF network has
    its weights for :math:`\beta` and no Gram matrix: it is a GP without the variance term.

    Args:
        inputs: (n, D), or (E, n, D) where the outputs have inputs of their own.
        weights: beta, (E, n).
        lengthscales: square roots of the diagonal of Lambda_a, (E, D), in the units of the inputs.
        signal_variance: alpha_a^2, (E,), in the squared units of the outputs.
        gram_inverse: K_a^-1, (E, n, n), or None for a deterministic function.
        noise_variance: sigma_a^2, (E,), or None for a deterministic function.
        offset: c_a, (E,), or 0.

    Example:
        >>> f = KernelExpansion(torch.zeros(1, 2), torch.ones(1, 1), torch.ones(1, 2), torch.ones(1))
        >>> f.mean(torch.zeros(2))
        tensor([1.])
    """

    inputs: Tensor
    weights: Tensor
    lengthscales: Tensor
    signal_variance: Tensor
    gram_inverse: Tensor | None = None
    noise_variance: Tensor | None = None
    offset: Tensor | float = 0.0

    @property
    def num_outputs(self) -> int:
        """E."""
        return self.weights.shape[0]

    @property
    def num_inputs(self) -> int:
        """D."""
        return self.inputs.shape[-1]

    @cached_property
    def precision(self) -> Tensor:
        """Diagonals of Lambda_a^-1, (E, D)."""
        return self.lengthscales.square().reciprocal()

    @cached_property
    def products(self) -> Products:
        """The pairs of outputs, and the precisions of their kernels' products."""
        return Products.of(self.precision)

    @cached_property
    def self_weights(self) -> Tensor:
        """beta_a beta_a' - K_a^-1, (E, n, n): the weights of Q in an output's own variance (Eq. 16). Needs ``gram_inverse``."""
        return self.weights[:, :, None] * self.weights[:, None, :] - self.gram_inverse

    @cached_property
    def pair_weights(self) -> tuple[Tensor, Tensor]:
        """Weights of the two outputs a < b of each product, (E (E - 1) / 2, n) each."""
        E = self.num_outputs
        return self.weights[self.products.first[E:]], self.weights[self.products.second[E:]]

    @cached_property
    def log_signal_variance(self) -> Tensor:
        """log alpha_a^2, (E,)."""
        return self.signal_variance.log()

    def kernel(self, x: Tensor) -> Tensor:
        """k_a(x, x_i) at points x (*batch, D): (*batch, E, n)."""
        scaled = (self.inputs - x[..., None, None, :]) / self.lengthscales[:, None, :]
        return self.signal_variance[:, None] * torch.exp(-scaled.square().sum(-1) / 2)

    def mean(self, x: Tensor) -> Tensor:
        """Posterior mean (Eq. 6) at points x (*batch, D): (*batch, E)."""
        return (self.kernel(x) * self.weights).sum(-1) + self.offset

    def predict(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean (Eq. 6) and variance (Eq. 7, without observation noise) at points x (*batch, D): both (*batch, E)."""
        k = self.kernel(x)
        mean = (k * self.weights).sum(-1) + self.offset
        if self.gram_inverse is None:
            return mean, torch.zeros_like(mean)
        explained = torch.einsum("...ei,eij,...ej->...e", k, self.gram_inverse, k)
        return mean, self.signal_variance - explained

    @classmethod
    def from_exact_gp(cls, model: gpytorch.models.ExactGP) -> KernelExpansion:
        """The posterior of a GPyTorch model, differentiable in its hyper-parameters and data.

        Args:
            model: an ``ExactGP`` with ``ScaleKernel(RBFKernel)`` (ARD or not), a zero or constant mean and a Gaussian
                likelihood; a batch shape of (E,) makes E outputs, none makes one.

        Raises:
            TypeError: another kernel, mean or likelihood.
            ValueError: more than one batch dimension.
            NotPositiveDefiniteError: names the output whose Gram matrix has no Cholesky factor.
        """
        _check_model(model)
        inputs, targets = model.train_inputs[0], model.train_targets
        lengthscales = model.covar_module.base_kernel.lengthscale.squeeze(-2)  # (*E, D)
        noise = model.likelihood.noise.squeeze(-1)
        signal = model.covar_module.outputscale
        offset = model.mean_module.constant if isinstance(model.mean_module, ConstantMean) else torch.zeros_like(signal)
        outputs = targets.shape[:-1] or (1,)
        return cls.from_data(
            inputs,
            targets.reshape(*outputs, -1),
            lengthscales.expand(*outputs, inputs.shape[-1]),
            signal.expand(outputs),
            noise.expand(outputs),
            offset.expand(outputs),
        )

    @classmethod
    def from_data(
        cls,
        inputs: Tensor,
        targets: Tensor,
        lengthscales: Tensor,
        signal_variance: Tensor,
        noise_variance: Tensor,
        offset: Tensor | float = 0.0,
    ) -> KernelExpansion:
        r"""The posterior given data: :math:`\beta_a = K_a^{-1} (y_a - c_a)` and :math:`K_a^{-1}` from one Cholesky factor.

        Args:
            inputs: (n, D) or (E, n, D).
            targets: (E, n).
            lengthscales, signal_variance, noise_variance, offset: as in the class, noise in squared units of the targets.

        Raises:
            NotPositiveDefiniteError: names the output whose Gram matrix has no Cholesky factor.
        """
        scaled = inputs / lengthscales[:, None, :]
        half = (scaled @ scaled.mT) - scaled.square().sum(-1, keepdim=True) / 2 - scaled.square().sum(-1)[..., None, :] / 2
        gram = signal_variance[:, None, None] * torch.exp(half) + torch.diag_embed(noise_variance[:, None].expand(-1, inputs.shape[-2]))
        factor = cholesky(gram, "Gram matrix of the outputs (element: output)")
        centred = targets - torch.as_tensor(offset, dtype=targets.dtype).reshape(-1, 1)
        weights = torch.cholesky_solve(centred[..., None], factor)[..., 0]
        inverse = torch.cholesky_inverse(factor)
        return cls(inputs, weights, lengthscales, signal_variance, inverse, noise_variance, offset)


def _check_model(model: gpytorch.models.ExactGP) -> None:
    kernel, mean, likelihood = model.covar_module, model.mean_module, model.likelihood
    if not (type(kernel) is ScaleKernel and type(kernel.base_kernel) is RBFKernel):
        raise TypeError(f"covar_module must be ScaleKernel(RBFKernel), got {type(kernel).__name__}")
    if kernel.active_dims is not None or kernel.base_kernel.active_dims is not None:
        raise TypeError("covar_module must see all inputs, got a kernel with active_dims")
    if model.train_targets.ndim > 2:
        raise ValueError(f"the model must have a batch of outputs (E,) or none, got {tuple(model.train_targets.shape[:-1])}")
    if not isinstance(mean, (ZeroMean, ConstantMean)):
        raise TypeError(f"mean_module must be ZeroMean or ConstantMean, got {type(mean).__name__}")
    if not isinstance(likelihood, gpytorch.likelihoods.GaussianLikelihood):
        raise TypeError(f"likelihood must be GaussianLikelihood, got {type(likelihood).__name__}")
