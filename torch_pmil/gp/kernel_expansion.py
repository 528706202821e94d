"""Weighted sums of squared exponentials: posterior means of Gaussian processes and RBF networks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import gpytorch
import torch
from gpytorch.kernels import RBFKernel, ScaleKernel
from gpytorch.means import ConstantMean, ZeroMean
from torch import Tensor

from torch_pmil.checks import check_finite_entries, check_real
from torch_pmil.gp.gaussian import cholesky
from torch_pmil.gp.kernel_pairs import KernelPairs, gram


@dataclass(frozen=True, eq=False)
class KernelExpansion:
    r"""E functions :math:`f_a(x) = c_a + \sum_i \beta_{ai} k_a(x, x_i)` with the kernel of Eq. 5.

    .. math::
        k_a(x, x') = \alpha_a^2 \exp\left(-\tfrac12 (x - x')^\top \Lambda_a^{-1} (x - x')\right)

    A GP posterior has :math:`\beta_a = K_a^{-1} (y_a - c_a)` and the inverse Gram matrix (which
    holds the noise); an RBF network has its weights for :math:`\beta` and no Gram matrix: it is a
    GP without the variance term.

    Args:
        inputs: (n, D).
        weights: beta, (E, n); a deterministic function may also have (N, E, n), other weights for
            each of the N points or beliefs at which it is evaluated.
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
        """Raise ValueError unless all parameters are finite, and those positive that must be."""
        for name in ("inputs", "weights", "lengthscales", "signal_variance"):
            check_finite_entries(name, getattr(self, name).detach())
        for name in ("lengthscales", "signal_variance"):
            _check_positive(name, getattr(self, name))

    @property
    def tensors(self) -> list[Tensor]:
        """Those of its arguments that are tensors."""
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
    def _minus_half_precision(self) -> Tensor:
        return self.precision / -2

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
        """Weights w and z of the two outputs of each product, (P, 1, n) or (N, P, 1, n) each.

        They multiply Q_ij as w_i z_j.
        """
        w, z = self.weights[..., self.pairs.first, :], self.weights[..., self.pairs.second, :]
        if self.gram_inverse is not None:
            one = torch.ones_like(self.weights)  # self_weights holds an output's own weights
            w, z = (torch.cat([one, weights[self.num_outputs :]]) for weights in (w, z))
        return w[..., None, :], z[..., None, :]

    @cached_property
    def self_weights(self) -> Tensor | None:
        """Weights of Q in an output's own variance (Eq. 16): beta_a beta_a' - K_a^-1, (E, n, n).

        None without a Gram matrix.
        """
        if self.gram_inverse is None:
            return None
        return torch.baddbmm(
            self.gram_inverse, self.weights[:, :, None], self.weights[:, None, :], beta=-1
        )

    @cached_property
    @torch.no_grad()
    def self_weights_norm(self) -> Tensor:
        """Frobenius norms of :attr:`self_weights`, (E,), without a graph: how much may cancel."""
        assert self.self_weights is not None
        return torch.linalg.matrix_norm(self.self_weights)

    @cached_property
    def prior_cov(self) -> Tensor:
        """Prior covariance of the outputs at one input, (E, E)."""
        return torch.diag_embed(self.signal_variance)

    @property
    def noise(self) -> Tensor:
        """Noise variance of an observation, (E,).

        Raises ValueError for a deterministic function, which has none.
        """
        if self.noise_variance is None:
            raise ValueError(
                "noisy observations need a noise_variance, got None, a deterministic function"
            )
        return self.noise_variance

    @cached_property
    def observed_prior_cov(self) -> Tensor:
        """Prior covariance of noisy observations of the outputs at one input (Eq. 5), (E, E)."""
        return torch.diag_embed(self.signal_variance + self.noise)

    def kernel(self, x: Tensor) -> Tensor:
        """Kernel values k_a(x, x_i), (*batch, E, n), at points x (*batch, D).

        Raises ValueError where points have another number of entries.
        """
        if x.shape[-1:] != self.inputs.shape[-1:]:
            raise ValueError(
                f"points must have the {self.num_inputs} inputs of the function, (*batch, "
                f"{self.num_inputs}), got {tuple(x.shape)}"
            )
        squares = (self.inputs.mT - x[..., None]).square()  # (*batch, D, n)
        return torch.exp(self._minus_half_precision @ squares + self.log_signal_variance[:, None])

    def mean(self, x: Tensor) -> Tensor:
        """Posterior mean (Eq. 6), (*batch, E), at points x (*batch, D)."""
        return (self.kernel(x) * self.weights).sum(-1) + self.offset

    def predict(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean (Eq. 6) and variance (Eq. 7) at points x (*batch, D), both (*batch, E).

        The variance does not include observation noise.
        """
        k = self.kernel(x)
        mean = (k * self.weights).sum(-1) + self.offset
        if self.gram_inverse is None:
            return mean, torch.zeros_like(mean)
        explained = torch.einsum("...ei,eij,...ej->...e", k, self.gram_inverse, k)
        return mean, self.signal_variance - explained

    def at_known(self, known: Tensor) -> KernelExpansion:
        r"""Functions of the first D - K inputs, one for each known value (N, K) of the others.

        The known inputs have no variance and take no part in any integral: :math:`\beta_{ai}
        \exp(-\tfrac12 \sum_k (\eta_k - x_{ik})^2 / \Lambda_{ak})` are weights.

        Example:
            >>> one = torch.ones(1)
            >>> f = KernelExpansion(torch.zeros(1, 2), one[None], torch.ones(1, 2), one)
            >>> f.at_known(torch.tensor([[0.0], [9.0]])).mean(torch.zeros(2, 1)).round()
            tensor([[1.],
                    [0.]])
        """
        D = self.num_inputs - known.shape[-1]
        of_known = KernelExpansion(
            self.inputs[:, D:],
            self.weights,
            self.lengthscales[:, D:],
            torch.ones_like(self.signal_variance),
        )
        weights = self.weights * of_known.kernel(known)
        return replace(
            self, inputs=self.inputs[:, :D], weights=weights, lengthscales=self.lengthscales[:, :D]
        )

    @classmethod
    def from_exact_gp(cls, model: gpytorch.models.ExactGP) -> KernelExpansion:
        """Posterior of a GPyTorch model, differentiable in its hyper-parameters and data.

        Args:
            model: an ``ExactGP`` with ``RBFKernel`` or ``ScaleKernel(RBFKernel)`` (ARD or not), a
                zero or constant mean and a Gaussian likelihood; a batch shape of (E,) makes E
                outputs, none makes one.

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
        offset = (
            model.mean_module.constant
            if isinstance(model.mean_module, ConstantMean)
            else torch.zeros_like(signal)
        )
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
        r"""Posterior given data, from one Cholesky factor of each output's Gram matrix.

        It has :math:`\beta_a = K_a^{-1} (y_a - c_a)` and :math:`K_a^{-1}`.

        Args:
            inputs: (n, D), or (E, n, D) where the outputs have inputs of their own: the expansion
                then holds all E n of them.
            targets: (E, n).
            lengthscales, signal_variance, noise_variance, offset: as in the class, noise in squared
                units of the targets.

        Raises:
            ValueError: shapes or dtypes do not fit, an entry is not finite, a lengthscale or a
                signal variance is not positive, or a noise variance negative.
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
        inverse = torch.cholesky_inverse(factor)
        return cls.joined(
            inputs, weights, lengthscales, signal_variance, inverse, noise_variance, offset
        )

    @classmethod
    def joined(
        cls,
        inputs: Tensor,
        weights: Tensor,
        lengthscales: Tensor,
        signal_variance: Tensor,
        gram_inverse: Tensor,
        noise_variance: Tensor,
        offset: Tensor | float = 0.0,
    ) -> KernelExpansion:
        """A posterior whose outputs may have inputs of their own, (E, n, D).

        It then holds all E n of them, with weights of zero where they are another output's. All
        other arguments are those of the class.
        """
        if inputs.ndim == 3:
            own = torch.eye(len(inputs), dtype=inputs.dtype, device=inputs.device)
            inputs = inputs.flatten(0, 1)
            weights = torch.einsum("ea,an->ean", own, weights).flatten(1)
            gram_inverse = torch.einsum("ea,eb,anm->eanbm", own, own, gram_inverse)
            gram_inverse = gram_inverse.flatten(3).flatten(1, 2)
        return cls(
            inputs, weights, lengthscales, signal_variance, gram_inverse, noise_variance, offset
        )


def check_data(
    inputs: Tensor,
    targets: Tensor,
    lengthscales: Tensor,
    signal_variance: Tensor,
    noise_variance: Tensor,
    offset: Tensor | float,
) -> None:
    check_real("inputs", inputs)
    check_real("targets", targets)
    E, n = targets.shape if targets.ndim == 2 else (1, 0)
    D = inputs.shape[-1] if inputs.ndim else 0
    expected = {
        "inputs": (inputs, (E, n, D) if inputs.ndim == 3 else (n, D)),
        "targets": (targets, (E, n)),
        "lengthscales": (lengthscales, (E, D)),
        "signal_variance": (signal_variance, (E,)),
        "noise_variance": (noise_variance, (E,)),
    }
    for name, (values, shape) in expected.items():
        if values.shape != shape or values.numel() == 0:
            raise ValueError(
                f"{name} must have shape {shape} and not be empty, got {tuple(values.shape)}"
            )
        if values.dtype != inputs.dtype or not values.is_floating_point():
            raise ValueError(
                f"{name} must be a float like inputs ({inputs.dtype}), got {values.dtype}"
            )
        check_finite_entries(name, values)
    offsets = torch.as_tensor(offset)
    if offsets.shape not in ((), (E,)) or not offsets.isfinite().all():
        raise ValueError(f"offset must be finite, and a number or {(E,)}, got {offset}")
    _check_positive("lengthscales", lengthscales)
    _check_positive("signal_variance", signal_variance)
    if not (noise_variance >= 0).all():
        raise ValueError(
            f"noise_variance must not be negative, got {noise_variance.min().item():.3g}"
        )


def _check_positive(name: str, values: Tensor) -> None:
    if not (values > 0).all():
        raise ValueError(f"{name} must be positive, got {values.min().item():.3g}")


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
