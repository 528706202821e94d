"""Weighted sums of squared exponentials: posterior means of Gaussian processes and RBF networks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import gpytorch
import torch
from gpytorch.kernels import RBFKernel, ScaleKernel
from gpytorch.means import ConstantMean, ZeroMean
from torch import Tensor

from torch_pmil.checks import (
    Shape,
    check_finite_entries,
    check_positive_entries,
    check_real,
    check_tensor,
)
from torch_pmil.gp.gaussian import cholesky
from torch_pmil.gp.kernel_pairs import KernelPairs, gram


@dataclass(frozen=True, eq=False)
class KernelExpansion:
    r"""E functions :math:`f_a(x) = c_a + \sum_i \beta_{ai} k_a(x, x_i)` with the kernel of Eq. 5.

    .. math::
        k_a(x, x') = \alpha_a^2 \exp\left(-\tfrac12 (x - x')^\top \Lambda_a^{-1} (x - x')\right)

    A GP posterior has :math:`\beta_a = K_a^{-1} (y_a - c_a)` and the inverse Gram matrix, noise
    included. An RBF network has its weights for :math:`\beta` and no Gram matrix.

    Args:
        inputs: (n, D).
        weights: beta, (E, n); for a deterministic function also (N, E, n), one row for each of the
            N points or beliefs at which it is evaluated.
        lengthscales: square roots of the diagonal of Lambda_a, (E, D), in the units of the inputs.
        signal_variance: alpha_a^2, (E,), in the squared units of the outputs.
        gram_inverse: K_a^-1, (E, n, n), or None for a deterministic function.
        noise_variance: sigma_a^2, (E,), or None for a deterministic function.
        offset: c_a, (E,), or 0.

    Raises:
        ValueError: shapes do not fit each other.

    Example:
        >>> one = torch.ones(1)
        >>> f = KernelExpansion(torch.zeros(1, 2), one[None], torch.ones(1, 2), one)
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

    def __post_init__(self) -> None:
        n, D = self.inputs.shape if self.inputs.ndim == 2 else (0, 0)
        E = self.weights.shape[-2] if self.weights.ndim > 1 else 0
        shapes = tuple(
            tuple(values.shape)
            for values in (self.inputs, self.weights, self.lengthscales, self.signal_variance)
        )
        inverse = None if self.gram_inverse is None else tuple(self.gram_inverse.shape)
        fit = shapes == ((n, D), (*shapes[1][:-2], E, n), (E, D), (E,)) and len(shapes[1]) < 4
        if not (fit and n and inverse in (None, (E, n, n))):
            raise ValueError(
                "inputs, weights, lengthscales and signal_variance must have shapes (n, D), (E, n)"
                f", (E, D) and (E,), and gram_inverse (E, n, n) if any, got "
                f"{', '.join(map(str, shapes))} and {inverse}"
            )

    def check_parameters(self) -> None:
        """Raise ValueError unless all parameters are finite, lengthscales and signal positive."""
        for name in ("inputs", "weights", "lengthscales", "signal_variance"):
            check_finite_entries(name, getattr(self, name).detach())
        for name in ("lengthscales", "signal_variance"):
            check_positive_entries(name, getattr(self, name))

    @property
    def tensors(self) -> list[Tensor]:
        """All arguments that are tensors."""
        values = (getattr(self, field.name) for field in fields(self))
        return [value for value in values if isinstance(value, Tensor)]

    @property
    def num_outputs(self) -> int:
        """Number of outputs E."""
        return self.weights.shape[-2]

    @property
    def num_inputs(self) -> int:
        """Number of inputs D."""
        return self.inputs.shape[-1]

    @cached_property
    def precision(self) -> Tensor:
        """Diagonals of the inverse squared lengthscales Lambda_a^-1, (E, D)."""
        return self.lengthscales.square().reciprocal()

    @cached_property
    def log_signal_variance(self) -> Tensor:
        """Logarithms of the signal variances alpha_a^2, (E,)."""
        return self.signal_variance.log()

    @cached_property
    def pairs(self) -> KernelPairs:
        """Pairs of outputs, and the precisions of their kernels' products."""
        return KernelPairs.of(self.precision, self.log_signal_variance)

    @cached_property
    def inputs_and_one(self) -> Tensor:
        """Inputs as columns, with a last row of ones, (D + 1, n)."""
        return torch.cat([self.inputs.mT, torch.ones_like(self.inputs[:, :1].mT)])

    @cached_property
    def pair_weights(self) -> tuple[Tensor, Tensor]:
        """Weights of each product Q, which are w_i z_j, (P, 1, n) or (N, P, 1, n) each."""
        w, z = self.weights[..., self.pairs.first, :], self.weights[..., self.pairs.second, :]
        if self.gram_inverse is not None:
            one = torch.ones_like(self.weights)  # self_weights holds an output's own weights
            w, z = (torch.cat([one, weights[self.num_outputs :]]) for weights in (w, z))
        return w[..., None, :], z[..., None, :]

    @cached_property
    def self_weights(self) -> Tensor | None:
        """Weights beta_a beta_a' - K_a^-1 of Q in an output's variance (Eq. 16), (E, n, n)."""
        if self.gram_inverse is None:
            return None
        return torch.baddbmm(
            self.gram_inverse, self.weights[:, :, None], self.weights[:, None, :], beta=-1
        )

    @cached_property
    @torch.no_grad()
    def self_weights_norm(self) -> Tensor:
        """Frobenius norms of :attr:`self_weights`, (E,): how much may cancel."""
        assert self.self_weights is not None
        return torch.linalg.matrix_norm(self.self_weights)

    @property
    def noise(self) -> Tensor:
        """Noise variance of an observation, (E,); ValueError for a deterministic function."""
        if self.noise_variance is None:
            raise ValueError(
                "noisy observations need a noise_variance, got None, a deterministic function"
            )
        return self.noise_variance

    def prior_variance(self, observation_noise: bool) -> Tensor:
        """Prior variances of the outputs at one input, or of noisy observations (Eq. 5), (E,)."""
        return self.signal_variance + self.noise if observation_noise else self.signal_variance

    def kernel(self, x: Tensor) -> Tensor:
        """Kernel values k_a(x, x_i), (*batch, E, n), at points x (*batch, D)."""
        if x.shape[-1:] != self.inputs.shape[-1:]:
            raise ValueError(
                f"points must have the {self.num_inputs} inputs of the function, (*batch, "
                f"{self.num_inputs}), got {tuple(x.shape)}"
            )
        squares = (self.inputs.mT - x[..., None]).square()  # (*batch, D, n)
        return torch.exp(self.precision / -2 @ squares + self.log_signal_variance[:, None])

    def mean(self, x: Tensor) -> Tensor:
        """Posterior mean (Eq. 6), (*batch, E), at points x (*batch, D)."""
        return (self.kernel(x) * self.weights).sum(-1) + self.offset

    def predict(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean (Eq. 6) and noise-free variance (Eq. 7), both (*batch, E)."""
        k = self.kernel(x)
        mean = (k * self.weights).sum(-1) + self.offset
        if self.gram_inverse is None:
            return mean, torch.zeros_like(mean)
        explained = torch.einsum("...ei,eij,...ej->...e", k, self.gram_inverse, k)
        return mean, self.signal_variance - explained

    def at_known(self, known: Tensor) -> KernelExpansion:
        r"""Functions of the first D - K inputs, one for each known value (N, K) of the others.

        Known inputs take no part in any integral: they only scale the weights, :math:`\beta_{ai}
        \exp(-\tfrac12 \sum_k (\eta_k - x_{ik})^2 / \Lambda_{ak})`.

        Example:
            >>> one = torch.ones(1)
            >>> f = KernelExpansion(torch.zeros(1, 2), one[None], torch.ones(1, 2), one)
            >>> f.at_known(torch.tensor([[0.0], [9.0]])).mean(torch.zeros(2, 1)).round()
            tensor([[1.],
                    [0.]])
        """
        if self.gram_inverse is not None:
            raise ValueError("known inputs must be those of a function without variance, got a GP")
        D = self.num_inputs - known.shape[-1]
        (inputs, others), (lengthscales, widths) = (
            t.tensor_split([D], -1) for t in (self.inputs, self.lengthscales)
        )
        one = torch.ones_like(self.signal_variance)
        weights = self.weights * KernelExpansion(others, self.weights, widths, one).kernel(known)
        return replace(self, inputs=inputs, weights=weights, lengthscales=lengthscales)

    @classmethod
    def from_exact_gp(cls, model: gpytorch.models.ExactGP) -> KernelExpansion:
        """Posterior of a GPyTorch model, differentiable in its hyper-parameters and data.

        Args:
            model: an ``ExactGP`` with ``RBFKernel`` or ``ScaleKernel(RBFKernel)``, a zero or
                constant mean and a Gaussian likelihood. Its batch shape (E,) are the outputs.

        Raises:
            TypeError: another kernel, mean or likelihood.
            ValueError: more than one batch dimension.
            NotPositiveDefiniteError: names the output whose Gram matrix has no Cholesky factor.
        """
        _check_model(model)
        inputs, targets = model.train_inputs[0], model.train_targets
        if inputs.ndim == 3 and (inputs == inputs[0]).all():
            inputs = inputs[0]
        kernel = model.covar_module
        scaled = isinstance(kernel, ScaleKernel)
        lengthscales = (kernel.base_kernel if scaled else kernel).lengthscale.squeeze(-2)  # (*E, D)
        noise = model.likelihood.noise.squeeze(-1)
        signal = kernel.outputscale if scaled else torch.ones_like(noise)
        constant = isinstance(model.mean_module, ConstantMean)
        offset = model.mean_module.constant if constant else torch.zeros_like(signal)
        outputs = targets.shape[:-1] or (1,)
        return cls.from_data(
            inputs,
            targets.reshape(*outputs, -1),
            lengthscales.expand(*outputs, inputs.shape[-1]).to(inputs),
            *(parameter.expand(outputs).to(inputs) for parameter in (signal, noise, offset)),
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
        """Posterior given data, from one Cholesky factor of each output's Gram matrix.

        Args:
            inputs: (n, D), or (E, n, D) where the outputs have inputs of their own.
            targets: (E, n).
            lengthscales, signal_variance, noise_variance, offset: as in the class.

        Raises:
            ValueError: shapes or dtypes do not fit, or an entry is not finite or out of range.
            NotPositiveDefiniteError: names the output whose Gram matrix has no Cholesky factor.
        """
        check_data(inputs, targets, lengthscales, signal_variance, noise_variance, offset)
        values = gram(inputs, inputs, lengthscales, signal_variance)
        values = values.diagonal_scatter(
            values.diagonal(dim1=1, dim2=2) + noise_variance[:, None], dim1=1, dim2=2
        )
        factor = cholesky(values, "Gram matrix of the outputs (element: output)")
        del values
        offsets = torch.as_tensor(offset, dtype=targets.dtype, device=targets.device)
        centred = targets - offsets.reshape(-1, 1)
        weights = torch.cholesky_solve(centred[..., None], factor)[..., 0]
        inputs, weights, inverse = joined(inputs, weights, torch.cholesky_inverse(factor))
        return cls(inputs, weights, lengthscales, signal_variance, inverse, noise_variance, offset)


def joined(inputs: Tensor, weights: Tensor, gram_inverse: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Join inputs (E, n, D) of the outputs; an output has zero weights at inputs of the others."""
    if inputs.ndim == 3:
        own = torch.eye(len(inputs), dtype=inputs.dtype, device=inputs.device)
        inputs = inputs.flatten(0, 1)
        weights = torch.einsum("ea,an->ean", own, weights).flatten(1)
        gram_inverse = torch.einsum("ea,eb,anm->eanbm", own, own, gram_inverse)
        gram_inverse = gram_inverse.flatten(3).flatten(1, 2)
    return inputs, weights, gram_inverse


def check_data(
    inputs: Tensor,
    targets: Tensor,
    lengthscales: Tensor,
    signal_variance: Tensor,
    noise_variance: Tensor,
    offset: Tensor | float,
) -> None:
    """Raise unless these are arguments of :meth:`KernelExpansion.from_data`."""
    check_real("inputs", inputs)
    check_tensor("targets", targets, ("E", "n"))
    E, n = targets.shape
    expected: dict[str, tuple[Tensor, Shape]] = {
        "inputs": (inputs, (E, n, "D") if inputs.ndim == 3 else (n, "D")),
        "targets": (targets, (E, n)),
        "lengthscales": (lengthscales, (E, *inputs.shape[-1:])),
        "signal_variance": (signal_variance, (E,)),
        "noise_variance": (noise_variance, (E,)),
    }
    for name, (values, shape) in expected.items():
        check_tensor(name, values, shape)
        if values.dtype != inputs.dtype or not values.is_floating_point():
            raise ValueError(
                f"{name} must be a float like inputs ({inputs.dtype}), got {values.dtype}"
            )
    offsets = torch.as_tensor(offset)
    if offsets.shape not in ((), (E,)) or not offsets.isfinite().all():
        raise ValueError(f"offset must be finite, and a number or {(E,)}, got {offset}")
    check_positive_entries("lengthscales", lengthscales)
    check_positive_entries("signal_variance", signal_variance)
    if not (noise_variance >= 0).all():
        raise ValueError(
            f"noise_variance must not be negative, got {noise_variance.min().item():.3g}"
        )


def _check_model(model: gpytorch.models.ExactGP) -> None:
    if not isinstance(model, gpytorch.models.ExactGP):
        raise TypeError(
            f"model must be an ExactGP or a KernelExpansion, got {type(model).__name__}"
        )
    kernel, mean, likelihood = model.covar_module, model.mean_module, model.likelihood
    base = kernel.base_kernel if type(kernel) is ScaleKernel else kernel
    if type(base) is not RBFKernel:
        got = f"ScaleKernel({type(base).__name__})" if base is not kernel else type(base).__name__
        raise TypeError(f"covar_module must be RBFKernel or ScaleKernel(RBFKernel), got {got}")
    if kernel.active_dims is not None or base.active_dims is not None:
        raise TypeError("covar_module must see all inputs, got a kernel with active_dims")
    if model.train_targets.ndim > 2:
        raise ValueError(
            "the model must have a batch of outputs (E,) or none, got "
            f"{tuple(model.train_targets.shape[:-1])}"
        )
    if not isinstance(mean, (ZeroMean, ConstantMean)):
        raise TypeError(f"mean_module must be ZeroMean or ConstantMean, got {type(mean).__name__}")
    if not isinstance(likelihood, gpytorch.likelihoods.GaussianLikelihood):
        raise TypeError(f"likelihood must be GaussianLikelihood, got {type(likelihood).__name__}")
