r"""Functions drawn from a posterior by pathwise conditioning (Wilson et al. 2020).

A function of the prior, from random Fourier features, gets the exact update that the data make to
it. A value then costs O(n), not O(n²).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.checks import check_whole
from torch_pmil.gp.gaussian import normal, symmetric
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.kernel_pairs import gram
from torch_pmil.model.compiled import kernels, serves

FREQUENCIES = 100  # the prior's covariances are then off by a tenth of its variance


@dataclass(frozen=True, eq=False)
class FunctionSamples:
    r"""N functions of E outputs, drawn from the posterior of an expansion with data.

    .. math::
        f_a(x) = c_a + \phi_a(x)^\top w_a + \sum_i v_{ai} k_a(x, x_i), \qquad
        v_a = \beta_a - G_a (\Phi_a w_a + \epsilon_a)

    The features :math:`\phi_a` are cosines and sines of J frequencies
    :math:`\omega \sim \mathcal N(0, \Lambda_a^{-1})`, which all samples share, with weights
    :math:`w \sim \mathcal N(0, \alpha_a^2 / J)`. With the inverse Gram matrix G and
    :math:`\operatorname{cov}(G \epsilon) = G - G K G`, the samples have the posterior's mean, and
    its covariance but for the features. For an exact posterior :math:`\epsilon` is the noise of the
    data; for a sparse one it is what the inducing values leave open.

    Args:
        expansion: the posterior, with weights beta and Gram matrix.
        frequencies: (E, J, D), in one over the units of the inputs.
        weights: of all cosines, then of all sines, (N, E, 2 J).
        updates: v, (N, E, n).

    Example:
        >>> x = torch.linspace(-2, 2, 20, dtype=torch.float64)[:, None]
        >>> from torch_pmil.model.dynamics import GPDynamics
        >>> model = GPDynamics(num_inputs=1, num_outputs=1)
        >>> _ = model.fit(x, x.sin())
        >>> functions = model.functions(50, torch.Generator().manual_seed(0))
        >>> at_zero = functions(torch.zeros(50, 1, dtype=torch.float64))
        >>> at_zero.shape, bool(at_zero.mean().abs() < 1e-2)
        (torch.Size([50, 1]), True)
    """

    expansion: KernelExpansion
    frequencies: Tensor
    weights: Tensor
    updates: Tensor

    @classmethod
    @torch.no_grad()
    def draw(
        cls, expansion: KernelExpansion, sparse: bool, count: int, generator: torch.Generator
    ) -> FunctionSamples:
        """Draw from an exact or sparse posterior; raises ValueError if the count is below one."""
        check_whole("count", count, 1)
        inputs, inverse, E = expansion.inputs, expansion.gram_inverse, expansion.num_outputs
        assert inverse is not None  # it is the posterior of a GP
        shape = E, FREQUENCIES, expansion.num_inputs
        frequencies = normal(shape, inputs, generator) / expansion.lengthscales[:, None]
        scale = (expansion.signal_variance / FREQUENCIES).sqrt()
        weights = scale[:, None] * normal((count, E, 2 * FREQUENCIES), inputs, generator)
        prior = weights.transpose(0, 1) @ _features(frequencies, inputs).mT  # (E, N, n)
        white = normal(prior.shape, inputs, generator)
        root = _root_of_sparse(expansion) if sparse else _root_of_exact(expansion)
        changes = prior @ inverse + white @ root
        updates = (expansion.weights[:, None] - changes).transpose(0, 1).contiguous()
        return cls(expansion, frequencies, weights, updates)

    def __len__(self) -> int:
        return len(self.weights)

    def __call__(self, inputs: Tensor) -> Tensor:
        r"""Outputs (N, \*batch, E) of each function at inputs (N, \*batch, D) of its own."""
        return kernels().outputs_of(self, inputs) if self._compiled(inputs) else self._sums(inputs)

    def _compiled(self, inputs: Tensor) -> bool:
        """Whether the kernels, which check no shapes themselves, compute these outputs."""
        f, size = self.expansion, inputs.shape
        fit = inputs.ndim > 1 and (size[0], size[-1]) == (len(self), f.num_inputs)
        constant = *f.tensors, self.frequencies, self.weights, self.updates
        return fit and serves(constant, [inputs])

    def _sums(self, inputs: Tensor) -> Tensor:
        """The outputs by the formulas in PyTorch."""
        features = _features(self.frequencies, inputs[..., None, None, :])[..., 0, :]
        of_prior = torch.einsum("n...ej,nej->n...e", features, self.weights)
        of_data = torch.einsum("n...ei,nei->n...e", self.expansion.kernel(inputs), self.updates)
        return of_prior + of_data + self.expansion.offset


def _features(frequencies: Tensor, inputs: Tensor) -> Tensor:
    r"""Cosines and sines (\*batch, E, n, 2 J) at inputs (\*batch, 1, n, D) or (n, D)."""
    phases = inputs @ frequencies.mT
    return torch.cat([phases.cos(), phases.sin()], -1)


def _root_of_exact(expansion: KernelExpansion) -> Tensor:
    r"""R (E, n, n) with :math:`R^\top R = G - G K G`, which is the noise times G²."""
    assert expansion.gram_inverse is not None
    return expansion.noise.sqrt()[:, None, None] * expansion.gram_inverse


def _root_of_sparse(expansion: KernelExpansion) -> Tensor:
    """The same where the data are inducing inputs."""
    inverse, inputs = expansion.gram_inverse, expansion.inputs
    assert inverse is not None
    between = gram(inputs, inputs, expansion.lengthscales, expansion.signal_variance)
    values, vectors = torch.linalg.eigh(symmetric(inverse - inverse @ between @ inverse))
    return values.clamp(min=0).sqrt()[..., None] * vectors.mT
