"""Gaussian integrals of kernels and of their products, against quadrature, the textbook, and their
limits.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.textbook import hermite_grid, textbook_Q, textbook_q
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.gp.gaussian_integrals import GaussianIntegrals
from torch_pmil.gp.kernel_expansion import KernelExpansion


def network(draws: Draws, n: int, D: int, E: int) -> KernelExpansion:
    """Of E kernels with signal variances of their own."""
    return KernelExpansion(
        draws.normal(n, D),
        draws.normal(E, n),
        draws.uniform(0.5, 2.0, E, D),
        draws.uniform(0.5, 2.0, E),
    )


def pair_matrices(integrals: GaussianIntegrals) -> Tensor:
    """Q of every belief and pair of outputs, (N, P, n, n)."""
    return (integrals.left.mT @ integrals.right).exp()


# --- quadrature and the textbook ---


@pytest.mark.parametrize("D", [1, 2])
@pytest.mark.parametrize("scale", [1e-6, 0.1, 0.5])
def test_integrals_are_those_of_quadrature(draws: Draws, D: int, scale: float) -> None:
    f, beliefs = network(draws, 5, D, 2), draws.belief(3, D, scale=scale)
    integrals = GaussianIntegrals.of(f, beliefs)
    Q = pair_matrices(integrals)
    for b in range(3):
        x, w = hermite_grid(beliefs[b])
        kernels = f.kernel(x)
        assert_close(integrals.q[b], (w[:, None, None] * kernels).sum(0), rtol=0, atol=1e-10)
        for p, (first, second) in enumerate(zip(f.pairs.first, f.pairs.second, strict=True)):
            expected = kernels[:, first].mT @ (w[:, None] * kernels[:, second])
            assert_close(Q[b, p], expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("scale", [0.0, 1e-8, 0.3, 30.0])
def test_integrals_are_those_of_the_textbook(draws: Draws, scale: float) -> None:
    f, beliefs = network(draws, 6, 3, 3), draws.belief(2, 3, scale=scale)
    integrals = GaussianIntegrals.of(f, beliefs)
    Q = pair_matrices(integrals)
    for index in range(2):
        mu, Sigma = beliefs.mean[index].numpy(), beliefs.cov[index].numpy()
        for a in range(3):
            np.testing.assert_allclose(
                integrals.q[index, a], textbook_q(f, a, mu, Sigma), rtol=1e-11
            )
        pairs = zip(f.pairs.first.tolist(), f.pairs.second.tolist(), strict=True)
        for p, (a, b) in enumerate(pairs):
            np.testing.assert_allclose(Q[index, p], textbook_Q(f, a, b, mu, Sigma), rtol=1e-11)


def test_precision_is_that_of_the_belief_widened_by_the_kernel(draws: Draws) -> None:
    f, beliefs = network(draws, 4, 3, 2), draws.belief(2, 3)
    widths = f.lengthscales.square()
    both = 1 / (1 / widths[:1] + 1 / widths[1:])
    widened = beliefs.cov[:, None] + torch.diag_embed(torch.cat([widths, widths / 2, both]))
    precision = GaussianIntegrals.of(f, beliefs).precision
    assert_close(precision, torch.linalg.inv(widened), rtol=1e-12, atol=1e-12)


def test_gradient(draws: Draws) -> None:
    f, belief = network(draws, 3, 2, 2), draws.belief(2, 2)

    def integrals(
        mean: Tensor, root: Tensor, inputs: Tensor, lengthscales: Tensor, signal: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        kernels = KernelExpansion(inputs, f.weights, lengthscales, signal)
        result = GaussianIntegrals.of(kernels, Gaussian(mean, root @ root.mT))
        return result.q, pair_matrices(result), result.precision

    root = torch.linalg.cholesky(belief.cov)
    variables = belief.mean, root, f.inputs, f.lengthscales, f.signal_variance
    assert gradcheck(integrals, tuple(variable.clone().requires_grad_() for variable in variables))


# --- limits ---


def test_zero_covariance_gives_the_kernels_and_their_products(draws: Draws) -> None:
    f, x = network(draws, 6, 3, 2), draws.normal(4, 3)
    integrals = GaussianIntegrals.of(f, Gaussian(x, torch.zeros(4, 3, 3, dtype=torch.float64)))
    kernels, products = f.kernel(x), f.pairs
    assert_close(integrals.q, kernels, rtol=1e-13, atol=0)
    expected = kernels[:, products.first, :, None] * kernels[:, products.second, None, :]
    assert_close(pair_matrices(integrals), expected, rtol=1e-12, atol=0)


def test_singular_covariance_is_the_limit_of_regular_ones(draws: Draws) -> None:
    f, direction = network(draws, 5, 3, 2), draws.normal(2, 3, 1)
    mean, line = draws.normal(2, 3), direction @ direction.mT
    on_the_line = GaussianIntegrals.of(f, Gaussian(mean, line))
    around = line + 1e-10 * torch.eye(3, dtype=torch.float64)
    nearly = GaussianIntegrals.of(f, Gaussian(mean, around))
    assert_close(on_the_line.q, nearly.q, rtol=1e-7, atol=0)
    assert_close(pair_matrices(on_the_line), pair_matrices(nearly), rtol=1e-7, atol=0)


@pytest.mark.parametrize(
    "scale", [0.0, 1e-12, 1.0, 1e2], ids=["certain", "narrow", "as wide as the kernels", "wide"]
)
@pytest.mark.parametrize("distance", [1e3, 1e6])
def test_data_far_away_do_not_count(draws: Draws, scale: float, distance: float) -> None:
    f, belief = network(draws, 5, 2, 2), draws.belief(3, 2, scale=scale)
    mean = (belief.mean + distance * f.lengthscales.max()).requires_grad_()
    integrals = GaussianIntegrals.of(f, Gaussian(mean, belief.cov))
    Q = pair_matrices(integrals)
    assert (integrals.q == 0).all() and (Q == 0).all()
    (gradient,) = torch.autograd.grad(integrals.q.sum() + Q.sum(), mean)
    assert (gradient == 0).all()


@pytest.mark.parametrize("distance", [10.0, 1e3])
def test_belief_that_reaches_data_far_away_gives_them_their_share(
    draws: Draws, distance: float
) -> None:
    """In one dimension, where a product of Gaussian densities is one: N(x; a, v) N(x; b, w) = N(x;
    c, ..) N(a; b, v + w).
    """
    f, mean, variance = network(draws, 5, 1, 2), distance, 9 * distance**2
    x, widths = f.inputs[:, 0], f.lengthscales[:, 0].square()
    factor = f.signal_variance * f.lengthscales[:, 0] * (2 * torch.pi) ** 0.5
    one = torch.ones(1, 1, dtype=torch.float64)
    integrals = GaussianIntegrals.of(f, Gaussian(mean * one, variance * one[None]))
    Q = pair_matrices(integrals)[0]

    def density(distances: Tensor, variance: Tensor) -> Tensor:
        return torch.exp(-distances.square() / variance / 2) / (2 * torch.pi * variance).sqrt()

    for a in range(2):
        expected = factor[a] * density(x - mean, widths[a] + variance)
        assert_close(integrals.q[0, a], expected, rtol=1e-13, atol=0)
    for p, (a, b) in enumerate(zip(f.pairs.first, f.pairs.second, strict=True)):
        centres = (widths[b] * x[:, None] + widths[a] * x) / (widths[a] + widths[b])
        both = density(centres - mean, variance + widths[a] * widths[b] / (widths[a] + widths[b]))
        expected = factor[a] * factor[b] * density(x[:, None] - x, widths[a] + widths[b]) * both
        assert_close(Q[p], expected, rtol=1e-15 * distance**2 + 1e-12, atol=0)


@pytest.mark.parametrize("distance", [1e3, 1e6])
@pytest.mark.parametrize("wide_direction", [0, 1])
def test_long_and_narrow_belief_far_away_has_finite_integrals(
    draws: Draws, distance: float, wide_direction: int
) -> None:
    f = network(draws, 5, 2, 2)
    variances = torch.full((2,), 1e-12, dtype=torch.float64)
    variances[wide_direction] = distance**2
    mean = torch.full((1, 2), distance, dtype=torch.float64)
    integrals = GaussianIntegrals.of(f, Gaussian(mean, torch.diag(variances)[None]))
    assert (integrals.q == 0).all() and (pair_matrices(integrals) == 0).all()
    for part in (integrals.left, integrals.right, integrals.precision):
        assert part.isfinite().all()


# --- errors ---


@pytest.mark.parametrize(
    ("value", "message"),
    [(-10.0, "got eigenvalues from"), (float("nan"), "not finite"), (float("inf"), "not finite")],
)
def test_covariance_that_is_none_is_an_error_that_names_the_belief(
    draws: Draws, value: float, message: str
) -> None:
    belief = draws.belief(3, 2)
    belief.cov[1] = value * torch.eye(2, dtype=torch.float64)
    with pytest.raises(NotPositiveDefiniteError, match=message) as error:
        GaussianIntegrals.of(network(draws, 4, 2, 2), belief)
    assert error.value.element == (1, 0)
