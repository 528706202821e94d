r"""Rounding errors of the moments of GPs and RBF networks, and what they refuse.

The variance (Eq. 16) is what remains of :math:`\alpha^2 - \operatorname{tr}(K^{-1} Q) + \beta^\top
Q \beta - \mu^2`, terms :math:`W_{ij} Q_{ij}` whose weights grow with the condition number of K.
Digits are lost in four ways, which the estimate adds up:

.. math::
    \Delta_{ab} = c \, \varepsilon \Big[
        \big\| W \circ Q \circ T \big\|_F
        + \kappa_a \big\| K_a^{-1} (Q \beta_b - q_a \mu_b) \big\|
        + |\mu_a| \textstyle\sum_j |\beta_{bj}| q_{bj} t_{bj}
        + (a \leftrightarrow b) + \alpha_a^2 \delta_{ab} \Big]

1. Each Q_ij is a rounded exponential. T_ij is one plus the size of the terms of its exponent, t_j
   the same for q_j (Eq. 15). The errors are independent, so that their squares add up.
2. The Cholesky factor is that of :math:`K + \delta K`, which moves :math:`\beta` by :math:`-K^{-1}
   \delta K \beta`. With the largest T of K as h, :math:`\kappa = \alpha^2 h \|\beta\|` bounds
   :math:`\delta K \beta`.
3. The mean is rounded before it is squared.
4. The sum is rounded; far from the data its largest term is the prior variance.

Ways 2 and 3 estimate the errors of the mean and its gradient, with q and its gradient in place of
the brackets of way 2.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian, Moments
from torch_pmil.gp.gaussian_integrals import GaussianIntegrals
from torch_pmil.gp.kernel_expansion import KernelExpansion

# the factor c; no random problem of the tests needed more than 2
SAFETY = 5.0
# numbers in the largest array of an estimate
LARGEST_ARRAY = 2**22


class InaccurateMomentsError(ValueError):
    """A variance is below its rounding error; ``element`` has the indices of belief and output."""

    def __init__(self, message: str, element: tuple[int, int]) -> None:
        super().__init__(message)
        self.element = element


@torch.no_grad()
def rounding_errors(f: KernelExpansion, belief: Gaussian) -> Moments:
    """Estimates of the absolute rounding errors of the moments of ``f`` at a Gaussian input.

    They are some thirty times the errors, and cost several calls of :func:`moment_match`. Errors of
    the data and of the hyper-parameters are not included.

    Args:
        f: a GP posterior or an RBF network.
        belief: belief over the D inputs, any batch shape.

    Example:
        >>> x, one = torch.zeros(1, 2, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
        >>> f = KernelExpansion.from_data(x, one[None], torch.ones_like(x), one, 0.01 * one)
        >>> errors = rounding_errors(f, Gaussian(x[0], torch.zeros(2, 2, dtype=torch.float64)))
        >>> bool(errors.cov < 1e-13)
        True
    """
    integrals = GaussianIntegrals.of(f, belief.flattened)
    sums, E, D = _Rounding(f, integrals), f.num_outputs, f.num_inputs
    slopes = integrals.precision[:, :E] @ integrals.nu1[:, None, :-1]  # B nu: gradients over q
    factors = torch.cat([torch.ones_like(slopes[:, :, :1]), slopes], 2)
    rounded = (factors.abs() @ sums.sizes[..., None]).squeeze(-1)
    moved = sums.solved((factors * sums.q[:, :, None]).mT, slice(None))
    single = rounded + sums.kappa[:, None] * moved  # (N, E, 1 + D)
    second = sums.second_moments(len(f.pairs.first))[:, f.pairs.position]
    unit, batch = SAFETY * torch.finfo(single.dtype).eps, belief.batch_shape
    return Moments(
        (unit * (single[..., 0] + (sums.mu + f.offset).abs())).reshape(*batch, E),
        (unit * second).reshape(*batch, E, E),
        (unit * single[..., 1:].mT).reshape(*batch, D, E),
    )


class _Rounding:
    """The terms of the estimates at N beliefs, over the machine epsilon.

    Attributes:
        q, mu: integrals (N, E, n) and means without offsets (N, E).
        sizes: the summands |beta_i| q_i t_i of the rounding of a mean, (N, E, n).
        rounded: their sums, (N, E).
        kappa: bound of a Cholesky factor's error times beta, (E,).
        prior: variances from which the sums are subtracted, (E,).
    """

    def __init__(self, f: KernelExpansion, integrals: GaussianIntegrals) -> None:
        self.f, self.left, self.right, self.q = f, integrals.left, integrals.right, integrals.q
        self.beta = f.weights.expand_as(self.q)
        self.mu = (self.beta * self.q).sum(-1)
        log_q = self.q.clamp(min=torch.finfo(self.q.dtype).tiny).log()
        t = 1 + (f.log_signal_variance[:, None] - log_q).abs()
        self.sizes = self.beta.abs() * self.q * t
        self.rounded = self.sizes.sum(-1)
        self.kappa = self.prior = torch.zeros_like(f.signal_variance)
        if f.gram_inverse is not None:
            self.prior = f.signal_variance
            scaled = (f.inputs - f.inputs.mean(0)) / f.lengthscales[:, None]
            h = 1 + scaled.square().sum(-1).amax(-1)
            self.kappa = f.signal_variance * h * f.weights.norm(dim=-1)

    def solved(self, columns: Tensor, outputs: Tensor | slice) -> Tensor:
        """Norms of K^-1 v for columns v of the outputs, (N, P, k) from (N, P, n, k)."""
        if self.f.gram_inverse is None:
            return torch.zeros_like(columns[..., 0, :])
        return (self.f.gram_inverse[outputs] @ columns).norm(dim=-2)

    def suffice(self, variances: Tensor, unit: float) -> bool:
        r"""Whether variances (N, E) of a GP surely exceed ``unit`` times their errors: O(n) work.

        Each :math:`Q_{ij} T_{ij}` is at most :math:`g_i h_j` with the roots g and h of Q_ii times
        one plus the lengths of ``left`` and ``right``. The factor of ``kappa`` is at most the
        signal-to-noise ratio times the root of twice the variance.
        """
        f, E = self.f, self.f.num_outputs
        left, right = self.left[:, :E], self.right[:, :E]
        root = ((left * right).sum(-2) / 2).exp()
        g, h = (root * (1 + side.norm(dim=-2)) for side in (left, right))
        exponentials = f.self_weights_norm * g.amax(-1) * h.amax(-1)
        through_factor = 2 * self.kappa * signal_to_noise(f) * (2 * variances).sqrt()
        of_mean = 2 * self.mu.abs() * self.rounded
        errors = exponentials + through_factor + of_mean + self.prior
        return bool((variances > unit * errors).all())

    def second_moments(self, count: int) -> Tensor:
        """Errors of the covariances of the first ``count`` pairs of outputs, (N, count)."""
        size = max(1, LARGEST_ARRAY // (count * self.q.shape[-1] ** 2))
        parts = [
            self._second_moments(slice(start, start + size), count)
            for start in range(0, len(self.q), size)
        ]
        return torch.cat(parts)

    def _second_moments(self, some: slice, count: int) -> Tensor:
        f, a, b = self.f, self.f.pairs.first[:count], self.f.pairs.second[:count]
        q, mu, beta, rounded = self.q[some], self.mu[some], self.beta[some], self.rounded[some]
        left, right = self.left[some, :count], self.right[some, :count]
        Q, T = (left.mT @ right).exp(), 1 + left.abs().mT @ right.abs()
        W = beta[:, a, :, None] * beta[:, b, None]
        if f.self_weights is not None:
            W[:, : f.num_outputs] = f.self_weights
        of_a = Q @ beta[:, b, :, None] - (q[:, a] * mu[:, b, None])[..., None]
        of_b = Q.mT @ beta[:, a, :, None] - (q[:, b] * mu[:, a, None])[..., None]
        through_factors = self.kappa[a] * self.solved(of_a, a)[..., 0]
        through_factors = through_factors + self.kappa[b] * self.solved(of_b, b)[..., 0]
        of_means = mu[:, a].abs() * rounded[:, b] + mu[:, b].abs() * rounded[:, a]
        errors = torch.linalg.matrix_norm(W * Q * T) + through_factors + of_means
        errors[:, : f.num_outputs] += self.prior
        return errors


@torch.no_grad()
def check_variances(f: KernelExpansion, integrals: GaussianIntegrals, variances: Tensor) -> None:
    """Raise InaccurateMomentsError where variances (N, E) are below their rounding errors."""
    sums, unit = _Rounding(f, integrals), SAFETY * torch.finfo(variances.dtype).eps
    if sums.suffice(variances, unit):
        return
    errors = unit * sums.second_moments(f.num_outputs)
    lost = (~(variances > errors)).nonzero()
    if len(lost):
        belief, output = element = int(lost[0, 0]), int(lost[0, 1])
        where = f" at belief {belief} of {len(variances)}" if len(variances) > 1 else ""
        raise InaccurateMomentsError(
            f"variance of output {output}{where} must exceed its rounding error "
            f"{errors[element]:.2g}, got {variances[element]:.2g} with a condition number "
            f"{condition_number(f, output):.2g} of its Gram matrix and a signal-to-noise ratio "
            f"{signal_to_noise(f)[output]:.3g}: more noise, fewer data or hyper-parameters that "
            "fit the targets help",
            element,
        )


def condition_number(f: KernelExpansion, output: int) -> float:
    """Condition number of the Gram matrix of one output of a GP."""
    assert f.gram_inverse is not None
    inverse = f.gram_inverse[output].detach()
    own = inverse.diagonal() > 0  # outputs with inputs of their own have rows of zeros
    values = torch.linalg.eigvalsh(inverse[own][:, own])
    return float(values[-1] / values[0])


def signal_to_noise(f: KernelExpansion) -> Tensor:
    """Signal-to-noise ratios alpha / sigma of a GP, (E,); infinite if unknown."""
    return (f.signal_variance / (0.0 if f.noise_variance is None else f.noise_variance)).sqrt()
