r"""Exact moments of GPs and RBF networks at a Gaussian input (Eqs. 14-18).

The symbols are those of a squared-exponential expansion:

==========================  ==================================================================
paper                       here
==========================  ==================================================================
:math:`\nu_i = x_i - \mu`   ``nu1`` of :class:`GaussianIntegrals`, with a last row of ones
:math:`q_i` (Eq. 15)        ``q`` of :class:`GaussianIntegrals`
:math:`Q_{ij}` (Eq. 17)     exp(left_i . right_j) of :class:`GaussianIntegrals`, never kept
:math:`\beta, K^{-1}`       ``weights``, ``gram_inverse`` of :class:`KernelExpansion`
==========================  ==================================================================

The variance (Eq. 16) is what remains of :math:`\alpha^2 - \operatorname{tr}(K^{-1} Q) + \beta^\top
Q \beta - \mu^2`, a sum of terms :math:`W_{ij} Q_{ij}` whose weights grow with the condition number
of K. It is lost in three ways, which the estimate adds:

.. math::
    \Delta_{ab} = c \, \varepsilon \Big[
        \big\| W \circ Q \circ T \big\|_F
        + \kappa_a \big\| K_a^{-1} (Q \beta_b - q_a \mu_b) \big\|
        + |\mu_a| \textstyle\sum_j |\beta_{bj}| q_{bj} t_{bj}
        + (a \leftrightarrow b) \Big]

1. Each Q_ij is a rounded exponential. T_ij is one plus the size of the terms of its exponent, t_j
   the same for q_j (Eq. 15). The errors are independent, so that their squares add up.
2. The Cholesky factor belongs to another matrix :math:`K + \delta K`, which moves :math:`\beta` by
   :math:`-K^{-1} \delta K \beta`. With the largest T of K as h, :math:`\kappa = \alpha^2 h
   \|\beta\|` bounds :math:`\delta K \beta`.
3. The mean is rounded before it is squared.

The mean and its gradient have the estimates of ways 2 and 3, with q and its gradient in the place
of the brackets of way 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import gpytorch
import torch
from torch import Tensor

from torch_pmil.gp.exponential_sums import ExponentialSum
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, check_belief
from torch_pmil.gp.gaussian_integrals import GaussianIntegrals
from torch_pmil.gp.kernel_expansion import KernelExpansion

# the factor c; no error of the random problems of the tests needed more than 2
SAFETY = 5.0
# numbers in the largest array of an estimate, whose beliefs are worked on together
LARGEST_ARRAY = 2**22
# squared lengthscales by which an eigenvalue of a belief may be negative: rounding, as of the
# features of a state that is certain
NO_VARIANCE = 1e-8


class InaccurateMomentsError(ValueError):
    """A variance is smaller than the rounding error of the sum that gives it.

    The indices of the belief and of the output are ``element``.
    """

    def __init__(self, message: str, element: tuple[int, int]) -> None:
        super().__init__(message)
        self.element = element


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of f(x) when x is Gaussian and f an expansion of E outputs.

    Args:
        mean: (*batch, E), in the units of the outputs.
        cov: (*batch, E, E).
        inv_cov_cross_cov: Sigma_x^-1 cov(x, f), (*batch, D, E): multiply by Sigma_x for the
            covariance itself, see :meth:`cross_cov`. It stays finite where Sigma_x is singular.
    """

    mean: Tensor  # (*batch, E)
    cov: Tensor  # (*batch, E, E)
    inv_cov_cross_cov: Tensor  # (*batch, D, E)

    @property
    def gaussian(self) -> Gaussian:
        """The Gaussian with this mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def unflatten(self, batch_shape: torch.Size) -> Moments:
        """These moments with the batch shape in place of their single batch dimension."""
        if len(batch_shape) == 1:
            return self
        flat = self.mean, self.cov, self.inv_cov_cross_cov
        return Moments(*(t.reshape(*batch_shape, *t.shape[1:]) for t in flat))

    def cross_cov(self, belief: Gaussian) -> Tensor:
        """Input-output covariance cov(x, f), (*batch, D, E).

        ``belief`` is the belief over x at which these moments were computed.
        """
        return belief.cov @ self.inv_cov_cross_cov


def moment_match(
    model: KernelExpansion | gpytorch.models.ExactGP,
    belief: Gaussian,
    observation_noise: bool = False,
    products: tuple[Tensor, Tensor] | None = None,
) -> Moments:
    r"""Mean, covariance and input-output covariance of a GP or RBF network at a Gaussian input.

    Exact (Eqs. 14-18), without sampling: the distribution of f(x) is not Gaussian, but its first
    two moments are these. Differentiable in the belief, the data and the hyper-parameters (once).

    Args:
        model: a trained GPyTorch ``ExactGP`` (``ScaleKernel(RBFKernel)``, zero or constant mean, E
            outputs as its batch), or a :class:`KernelExpansion`, which keeps its Cholesky factors'
            results between calls.
        belief: belief over the D inputs, any batch shape; its covariance may be singular or zero.
        observation_noise: whether to add the likelihood's noise to the variances (Eq. 5), for the
            distribution of an observation.
        products: ``RecordedMoments.products`` of the same model at the same beliefs, which save
            nearly all of the work.

    Returns:
        Moments in the units of the outputs.

    Raises:
        TypeError: the model or the belief is of another kind.
        ValueError: the belief's entries are not the model's inputs, its mean is not finite, or its
            dtype is not the model's; a parameter of the model is not finite or not positive; or
            noise is asked of a function that has none.
        NotPositiveDefiniteError: the covariance has a clearly negative eigenvalue, is not
            symmetric, or is not finite.
        InaccurateMomentsError: a variance of a GP is less than its rounding error.

    Accuracy: the errors of all moments are below :func:`rounding_errors`, and those of a GP's
    variances below the variances, or the moments are refused. Gradients by the belief's mean have
    errors of that estimate over a lengthscale; a difference quotient of step h has that estimate
    over h, and is the less accurate of the two. The variance of a network that hardly varies over
    the belief may be a negative number within its estimate.

    Source: Deisenroth (2010), section 2.3.

    Example:
        >>> one = torch.ones(1)
        >>> f = KernelExpansion(torch.zeros(1, 2), one[None], torch.ones(1, 2), one)
        >>> moment_match(f, Gaussian(torch.zeros(2), torch.zeros(2, 2))).mean
        tensor([1.])
    """
    f = model if isinstance(model, KernelExpansion) else KernelExpansion.from_exact_gp(model)
    if observation_noise and f.noise_variance is None:
        raise ValueError("observation_noise must be False for a deterministic function, got True")
    if products is None:
        check_belief(belief, "belief", f.inputs, NO_VARIANCE * f.lengthscales.detach().amin() ** 2)
    beliefs = belief.flattened
    try:
        integrals = GaussianIntegrals.of(f, beliefs)
    except NotPositiveDefiniteError:
        f.check_parameters()  # the cause, if a lengthscale is zero or not finite
        raise
    sums = (f.weights * integrals.q) @ integrals.nu1.mT  # sum_i beta_i q_i [nu_i, 1], (N, E, D + 1)
    second = ExponentialSum.apply(
        integrals.left, integrals.right, *f.pair_weights, f.self_weights, f.num_inputs, products
    )
    slope = first_slope(integrals.precision, sums)
    moments = combine(f, sums[..., -1], slope, second, observation_noise)
    if f.gram_inverse is not None and products is None:
        check_variances(f, integrals, moments.cov.diagonal(dim1=-2, dim2=-1))
    if products is None and not moments.mean.isfinite().all():
        f.check_parameters()
    return moments.unflatten(belief.batch_shape)


def first_slope(precision: Tensor, sums: Tensor) -> Tensor:
    r"""Gradient of the mean, Sigma^-1 cov(x, f) = B sum_i beta_i q_i nu_i, (N, E, D).

    Args:
        precision: B of all integrals, (N, E + P, D, D).
        sums: sum_i beta_i q_i [nu_i, 1] of each output, (N, E, D + 1).
    """
    return (precision[:, : sums.shape[1]] @ sums[..., :-1, None]).squeeze(-1)


def combine(
    f: KernelExpansion, mean: Tensor, slope: Tensor, second: Tensor, observation_noise: bool
) -> Moments:
    r"""Moments at N beliefs from uncentred second moments (Eq. 16), with the offsets added.

    Args:
        f: the expansion whose moments they are.
        mean: means without offsets (Eq. 14), (N, E).
        slope: Sigma^-1 cov(x, f) as in :func:`first_slope`, (N, E, D).
        second: E[f_a f_b] of each pair of outputs, without offsets and prior variance, (N, P).
        observation_noise: as in :func:`moment_match`.
    """
    E = f.num_outputs
    second = second.index_select(-1, f.pairs.position).view(-1, E, E)
    cov = torch.baddbmm(second, mean[:, :, None], mean[:, None], alpha=-1)
    if f.gram_inverse is not None:
        cov = cov + (f.observed_prior_cov if observation_noise else f.prior_cov)
    return Moments(mean + f.offset, cov, slope.mT)


@torch.no_grad()
def rounding_errors(f: KernelExpansion, belief: Gaussian) -> Moments:
    """Estimates of the absolute rounding errors of the moments of ``f`` at a Gaussian input.

    They are above the errors, some thirty times as a rule, and cost several calls of
    :func:`moment_match`. How exact the data and the hyper-parameters are is no
    part of them.

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
    """

    def __init__(self, f: KernelExpansion, integrals: GaussianIntegrals) -> None:
        self.f, self.left, self.right, self.q = f, integrals.left, integrals.right, integrals.q
        self.beta = f.weights.expand_as(self.q)
        self.mu = (self.beta * self.q).sum(-1)
        log_q = self.q.clamp(min=torch.finfo(self.q.dtype).tiny).log()
        t = 1 + (f.log_signal_variance[:, None] - log_q).abs()
        self.sizes = self.beta.abs() * self.q * t
        self.rounded = self.sizes.sum(-1)
        self.kappa = torch.zeros_like(f.signal_variance)
        if f.gram_inverse is not None:
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
        one plus the lengths of ``left`` and ``right``. What follows ``kappa`` is at most the
        signal-to-noise ratio times the root of the variance, which is at most twice the one that
        was found, if the error is less.
        """
        f, E = self.f, self.f.num_outputs
        left, right = self.left[:, :E], self.right[:, :E]
        root = ((left * right).sum(-2) / 2).exp()
        g, h = (root * (1 + side.norm(dim=-2)) for side in (left, right))
        exponentials = f.self_weights_norm * g.amax(-1) * h.amax(-1)
        through_factor = 2 * self.kappa * signal_to_noise(f) * (2 * variances).sqrt()
        of_mean = 2 * self.mu.abs() * self.rounded
        return bool((variances > unit * (exponentials + through_factor + of_mean)).all())

    def second_moments(self, count: int) -> Tensor:
        """Errors of the covariances of the first ``count`` pairs of outputs, (N, count).

        The first E are the variances.
        """
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
        return torch.linalg.matrix_norm(W * Q * T) + through_factors + of_means


@torch.no_grad()
def check_variances(f: KernelExpansion, integrals: GaussianIntegrals, variances: Tensor) -> None:
    """Refuse variances (N, E) of a GP at N beliefs that are less than their rounding errors.

    Raises:
        InaccurateMomentsError: names the output, the error, and what to change.
    """
    sums, unit = _Rounding(f, integrals), SAFETY * torch.finfo(variances.dtype).eps
    if sums.suffice(variances, unit):
        return
    errors = unit * sums.second_moments(f.num_outputs)
    lost = ~(variances > errors)
    if lost.any():
        element = int(lost.nonzero()[0, 0]), int(lost.nonzero()[0, 1])
        where = f" at belief {element[0]} of {len(variances)}" if len(variances) > 1 else ""
        output = element[1]
        raise InaccurateMomentsError(
            f"variance of output {output}{where} must exceed its rounding error "
            f"{errors[element]:.2g}, got {variances[element]:.2g} with a condition number "
            f"{condition_number(f, output):.2g} of its Gram matrix and a signal-to-noise ratio "
            f"{signal_to_noise(f)[output]:.3g}: more noise, fewer data or hyper-parameters that "
            "fit the targets help",
            element,
        )


def condition_number(f: KernelExpansion, output: int) -> float:
    """Condition number of the Gram matrix of an output of a GP."""
    assert f.gram_inverse is not None
    inverse = f.gram_inverse[output].detach()
    own = inverse.diagonal() > 0  # outputs with inputs of their own have rows of zeros
    values = torch.linalg.eigvalsh(inverse[own][:, own])
    return float(values[-1] / values[0])


def signal_to_noise(f: KernelExpansion) -> Tensor:
    """Signal-to-noise ratio alpha / sigma of each output of a GP, (E,); infinite if unknown."""
    return (f.signal_variance / (0.0 if f.noise_variance is None else f.noise_variance)).sqrt()
