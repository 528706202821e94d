r"""The posterior of a Gaussian process at many particles, with a gradient by hand.

``KernelExpansion.predict`` leaves the gradient to autograd, which multiplies by :math:`K_a^{-1}`
anew. Here the one product of the value, :math:`v = K_a^{-1} k`, serves the gradient too:

.. math:: \frac{\partial \mu_a}{\partial k} = \beta_a, \qquad
    \frac{\partial \sigma_a^2}{\partial k} = -2 v
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
    def scaled_inputs(self) -> Tensor:
        """Inputs times the precision of the kernel, and a last column of ones, (E, n, D + 1)."""
        scaled = self.expansion.inputs * self._precision[:, None, :]
        return torch.cat([scaled, torch.ones_like(scaled[..., :1])], -1)

    @cached_property
    def _precision(self) -> Tensor:
        return self.expansion.lengthscales.square().reciprocal()  # (E, D)

    @cached_property
    def _exponents(self) -> Tensor:
        """Coefficients of [x, x^2, 1] in the logarithms of the kernels, (E, 2 D + 1, n)."""
        f, linear = self.expansion, self.scaled_inputs[..., :-1]  # (E, n, D)
        squares = -self._precision[..., None].expand(-1, -1, len(f.inputs)) / 2
        constant = f.signal_variance.log()[:, None] - (linear * f.inputs).sum(-1) / 2
        return torch.cat([linear.mT, squares, constant[:, None, :]], 1)

    def kernel(self, x: Tensor) -> Tensor:
        """Kernel values (E, N, n) at points (N, D)."""
        terms = torch.cat([x, x.square(), torch.ones_like(x[:, :1])], -1)
        return (terms @ self._exponents).exp_()

    def slope(self, x: Tensor, of_exponents: Tensor) -> Tensor:
        """Gradient (N, D) at points of a function, given that of the exponents (E, N, n)."""
        sums = of_exponents @ self.scaled_inputs  # (E, N, D + 1)
        return (sums[..., :-1] - sums[..., -1:] * self._precision[:, None, :] * x).sum(0)


class _Predict(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, posterior: ParticlePosterior) -> tuple[Tensor, Tensor]:
        f = posterior.expansion
        assert f.gram_inverse is not None
        k = posterior.kernel(x)
        v = k @ f.gram_inverse  # (E, N, n)
        mean = (k @ f.weights[..., None])[..., 0].mT + f.offset
        variance = f.signal_variance - torch.linalg.vecdot(k, v).mT
        ctx.save_for_backward(x, k, v)
        ctx.posterior = posterior
        return mean, variance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, of_mean: Tensor, of_variance: Tensor) -> tuple[Tensor, None]:
        x, k, v = ctx.saved_tensors
        beta = ctx.posterior.expansion.weights[:, None, :]
        of_k = torch.addcmul(of_mean.mT[..., None] * beta, of_variance.mT[..., None], v, value=-2)
        return ctx.posterior.slope(x, of_k.mul_(k)), None
