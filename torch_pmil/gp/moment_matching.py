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
"""

from __future__ import annotations

import gpytorch
import torch

from torch_pmil.gp.exponential_sums import ExponentialSum
from torch_pmil.gp.gaussian import Gaussian, Moments, NotPositiveDefiniteError, check_belief
from torch_pmil.gp.gaussian_integrals import GaussianIntegrals
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_accuracy import check_variances

# squared lengthscales by which an eigenvalue of a belief may be negative: rounding, for example of
# the features of a certain state
NO_VARIANCE = 1e-8


def moment_match(
    model: KernelExpansion | gpytorch.models.ExactGP,
    belief: Gaussian,
    observation_noise: bool = False,
) -> Moments:
    r"""Mean, covariance and input-output covariance of a GP or RBF network at a Gaussian input.

    Exact (Eqs. 14-18), without sampling: the distribution of f(x) is not Gaussian, but its first
    two moments are these. Differentiable in the belief, the data and the hyper-parameters (once).

    Args:
        model: a :class:`KernelExpansion`, or a trained GPyTorch model, for
            :meth:`KernelExpansion.from_exact_gp` at each call.
        belief: belief over the D inputs, any batch shape; its covariance may be singular or zero.
        observation_noise: whether to add the likelihood's noise to the variances (Eq. 5).

    Returns:
        Moments in the units of the outputs.

    Raises:
        TypeError: the model or the belief is of another kind.
        ValueError: the belief does not fit the model, its mean is not finite, a parameter of the
            model is not finite or not positive, or a deterministic function has no noise.
        NotPositiveDefiniteError: the covariance has a clearly negative eigenvalue, is not
            symmetric, or is not finite.
        InaccurateMomentsError: a variance of a GP is less than its rounding error.

    Accuracy: errors are below the estimates of :func:`rounding_errors`. Errors of gradients with
    respect to the belief's mean are about that estimate divided by a lengthscale. Errors of
    difference quotients with step h are about that estimate divided by h. The variance of a network
    that is almost constant over the belief may be negative by no more than the estimate.

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
    check_belief(belief, "belief", f.inputs, NO_VARIANCE * f.lengthscales.detach().amin() ** 2)
    beliefs = belief.flattened
    try:
        integrals = GaussianIntegrals.of(f, beliefs)
    except NotPositiveDefiniteError:
        f.check_parameters()  # the cause, if a lengthscale is zero or not finite
        raise
    moments = _combine(f, integrals, observation_noise)
    if f.gram_inverse is not None:
        check_variances(f, integrals, moments.cov.diagonal(dim1=-2, dim2=-1))
    if not moments.mean.isfinite().all():
        f.check_parameters()
    return moments.unflatten(belief.batch_shape)


def exact_moments(f: KernelExpansion, belief: Gaussian, observation_noise: bool = False) -> Moments:
    """:func:`moment_match` at N beliefs, with no check but that of Cholesky factors."""
    return _combine(f, GaussianIntegrals.of(f, belief), observation_noise)


def _combine(f: KernelExpansion, integrals: GaussianIntegrals, observation_noise: bool) -> Moments:
    """Moments at N beliefs from the integrals of the kernels."""
    E = f.num_outputs
    sums = (f.weights * integrals.q) @ integrals.nu1.mT  # sum_i beta_i q_i [nu_i, 1], (N, E, D + 1)
    mean = sums[..., -1]
    slope = (integrals.precision[:, :E] @ sums[..., :-1, None]).squeeze(-1)  # Sigma^-1 cov(x, f)
    second = ExponentialSum.apply(
        integrals.left, integrals.right, *f.pair_weights, f.self_weights, f.num_inputs
    )
    second = second.index_select(-1, f.pairs.position).view(-1, E, E)
    cov = torch.baddbmm(second, mean[:, :, None], mean[:, None], alpha=-1)
    if f.gram_inverse is not None:
        cov = cov + torch.diag_embed(f.prior_variance(observation_noise))
    return Moments(mean + f.offset, cov, slope.mT)
