r"""The posterior of a Gaussian process at many particles, with its slopes in one go.

``KernelExpansion.predict`` leaves the gradient to autograd, which multiplies by :math:`K_a^{-1}`
anew and keeps all kernel values. Here the one product :math:`K_a^{-1} k` gives value and slope:

.. math:: \frac{\partial \mu_a}{\partial x} = \sum_i \beta_{ai} k_{ai} \Lambda_a^{-1} (x_i - x),
    \qquad \frac{\partial \sigma_a^2}{\partial x}
    = -2 \sum_i (K_a^{-1} k_a)_i \, k_{ai} \Lambda_a^{-1} (x_i - x)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torch_pmil.gp.kernel_expansion import KernelExpansion


@dataclass(frozen=True, eq=False)
class ParticlePosterior:
    """Mean and variance of an expansion of a Gram matrix (Eqs. 6 and 7), at N points in a row.

    Example:
        >>> one = torch.ones(1).double()
        >>> data = torch.zeros(1, 1).double(), one[:, None], one[:, None], one, one
        >>> posterior = ParticlePosterior(KernelExpansion.from_data(*data))
        >>> mean, variance = posterior.predict(torch.zeros(1, 1).double())
        >>> round(mean.item(), 6), round(variance.item(), 6)
        (0.5, 0.5)
    """

    expansion: KernelExpansion

    def predict(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and variance, without noise, (N, E) each, at points (N, D).

        Differentiable once, in the points alone.
        """
        predicted: tuple[Tensor, Tensor] = _Predict.apply(x, self)
        return predicted

    @cached_property
    def _precision(self) -> Tensor:
        return self.expansion.lengthscales.square().reciprocal()  # (E, D)

    @cached_property
    def _scaled_inputs(self) -> Tensor:
        """Inputs times the precision of the kernel, and a last column of ones, (E, n, D + 1)."""
        scaled = self.expansion.inputs * self._precision[:, None, :]
        return torch.cat([scaled, torch.ones_like(scaled[..., :1])], -1)

    @cached_property
    def _weighted_inputs(self) -> Tensor:
        """The same times the weights beta, (E, n, D + 1)."""
        return self.expansion.weights[..., None] * self._scaled_inputs

    @cached_property
    def _exponents(self) -> Tensor:
        """Coefficients of [x, x^2, 1] in the logarithms of the kernels, (E, 2 D + 1, n)."""
        f, linear = self.expansion, self._scaled_inputs[..., :-1]  # (E, n, D)
        squares = -self._precision[..., None].expand(-1, -1, len(f.inputs)) / 2
        constant = f.signal_variance.log()[:, None] - (linear * f.inputs).sum(-1) / 2
        return torch.cat([linear.mT, squares, constant[:, None, :]], 1)

    def with_slopes(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Mean and variance (N, E) at points (N, D), and their slopes (E, N, D)."""
        f = self.expansion
        assert f.gram_inverse is not None
        terms = torch.cat([x, x.square(), torch.ones_like(x[:, :1])], -1)
        k = (terms @ self._exponents).exp_()  # (E, N, n)
        explained = (k @ f.gram_inverse).mul_(k)
        mean, of_mean = self._sums(k @ self._weighted_inputs, x)
        reduction, of_reduction = self._sums(explained @ self._scaled_inputs, x)
        variance = f.signal_variance - reduction.mT
        return mean.mT + f.offset, variance, of_mean, -2 * of_reduction

    def _sums(self, weighted: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        """Sums of weights (E, N), and of weights times Lambda^-1 (x_i - x), (E, N, D)."""
        total = weighted[..., -1]
        return total, weighted[..., :-1] - total[..., None] * self._precision[:, None, :] * x


class _Predict(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, posterior: ParticlePosterior) -> tuple[Tensor, Tensor]:
        mean, variance, *slopes = posterior.with_slopes(x)
        ctx.save_for_backward(*slopes)
        return mean, variance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_mean: Tensor, of_variance: Tensor) -> tuple[Tensor, None]:
        mean_slope, variance_slope = ctx.saved_tensors
        slopes = of_mean.mT[..., None] * mean_slope + of_variance.mT[..., None] * variance_slope
        return slopes.sum(0), None
