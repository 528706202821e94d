"""Kullback-Leibler divergences, against torch's, quadrature, and the paper's gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.distributions import MultivariateNormal, kl_divergence
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, symmetric
from torch_pmil.search.kl import (
    gaussian_cross_entropy,
    gaussian_kl,
    gaussian_kl_terms,
    mean_kl,
    trajectory_kl,
)


def test_kl_and_cross_entropy_are_those_of_torch(draws: Draws) -> None:
    p, q = draws.belief(3, 5, 4), draws.belief(3, 5, 4)
    ours, theirs = MultivariateNormal(p.mean, p.cov), MultivariateNormal(q.mean, q.cov)
    expected = kl_divergence(ours, theirs)
    assert_close(gaussian_kl(p, q), expected, rtol=1e-10, atol=1e-10)
    expected = expected + ours.entropy()
    assert_close(gaussian_cross_entropy(p, q), expected, rtol=1e-10, atol=1e-10)


def test_kl_is_that_of_quadrature(draws: Draws) -> None:
    p, q = draws.belief(1), draws.belief(1)
    nodes, weights = (torch.as_tensor(a) for a in np.polynomial.hermite_e.hermegauss(20))
    x = p.mean + nodes[:, None] * p.std
    log_p, log_q = (MultivariateNormal(belief.mean, belief.cov).log_prob(x) for belief in (p, q))
    expected = weights @ (log_p - log_q) / (2 * torch.pi) ** 0.5
    assert_close(gaussian_kl(p, q), expected, rtol=1e-10, atol=1e-10)


def test_cross_entropy_is_least_at_a_point_in_the_mean(draws: Draws) -> None:
    p = draws.belief(3)
    point = Gaussian(p.mean, 1e-12 * torch.eye(3).double())
    others = [Gaussian(p.mean, p.cov), Gaussian(p.mean + 0.1, point.cov)]
    assert all(gaussian_cross_entropy(point, p) < gaussian_cross_entropy(q, p) for q in others)


def test_gradients_in_the_prediction_are_those_of_the_paper(draws: Draws) -> None:
    """Eq. 23, and Eq. 24 with the demonstrated covariance in the inner term, as it must be."""
    p, q = draws.belief(4), draws.belief(4)
    mean, cov = q.mean.clone().requires_grad_(), q.cov.clone().requires_grad_()
    d_mean, d_cov = torch.autograd.grad(gaussian_kl(p, Gaussian(mean, cov)), (mean, cov))

    inv_cov, delta = torch.linalg.inv(q.cov), p.mean - q.mean
    eq_23 = -inv_cov @ delta
    eq_24 = inv_cov / 2 - inv_cov @ (p.cov + torch.outer(delta, delta)) @ inv_cov / 2
    assert_close(d_mean, eq_23, rtol=1e-10, atol=1e-10)
    assert_close(symmetric(d_cov), eq_24, rtol=1e-10, atol=1e-10)


def test_kl_is_zero_for_equal_beliefs_alone_and_not_symmetric(draws: Draws) -> None:
    p, q = draws.belief(10, 3), draws.belief(10, 3)
    assert (gaussian_kl(p, p).abs() <= 1e-12).all()
    assert (gaussian_kl(p, q) > 0).all()
    assert (gaussian_kl(p, Gaussian(p.mean, 1.01 * p.cov)) > 0).all()
    assert (gaussian_kl(p, Gaussian(p.mean + 0.01, p.cov)) > 0).all()
    assert not torch.isclose(gaussian_kl(p, q), gaussian_kl(q, p)).any()


def test_kl_does_not_change_under_an_affine_map(draws: Draws) -> None:
    p, q, matrix, offset = draws.belief(3), draws.belief(3), draws.normal(3, 3), draws.normal(3)
    assert_close(gaussian_kl(p.affine(matrix, offset), q.affine(matrix, offset)), gaussian_kl(p, q))


def test_batches_broadcast(draws: Draws) -> None:
    p, q = draws.belief(4, 2), draws.belief(3, 4, 2)
    together = gaussian_kl(p, q)
    assert together.shape == (3, 4)
    for i, j in np.ndindex(3, 4):
        assert_close(together[i, j], gaussian_kl(p[j], q[i, j]))


def test_trajectory_kl_is_the_sum_over_time(draws: Draws) -> None:
    demonstrated, predicted = draws.belief(6, 2), draws.belief(3, 6, 2)
    expected = sum(gaussian_kl(demonstrated[t], predicted[:, t]) for t in range(6))
    assert_close(trajectory_kl(demonstrated, predicted), expected)


def test_mean_kl_is_the_kl_at_equal_covariances(draws: Draws) -> None:
    demonstrated, mean = draws.belief(5, 3), draws.normal(5, 3)
    assert_close(
        mean_kl(demonstrated, mean), gaussian_kl(demonstrated, Gaussian(mean, demonstrated.cov))
    )


def test_singular_covariance_is_an_error_that_names_the_element(draws: Draws) -> None:
    p, q = draws.belief(3, 2), draws.belief(3, 2)
    q.cov[1] = -torch.eye(2)
    with pytest.raises(NotPositiveDefiniteError, match=r"covariance of q .* batch element \(1,\)"):
        gaussian_kl(p, q)


def test_terms_are_those_of_the_mean_and_the_spread_of_each_entry(draws: Draws) -> None:
    """None is negative, and an entry's is what it adds to the KL of those before it."""
    p, q = draws.belief(5, 3, 4), draws.belief(5, 3, 4)
    terms = gaussian_kl_terms(p, q)
    both = terms.mean + terms.spread
    assert_close(both.sum(-1), gaussian_kl(p, q), rtol=1e-12, atol=1e-12)
    assert terms.mean.shape == terms.spread.shape == (5, 3, 4)
    assert (terms.mean >= 0).all() and (terms.spread >= 0).all()
    of_mean, of_spread = Gaussian(p.mean, q.cov), Gaussian(q.mean, p.cov)
    assert_close(terms.mean.sum(-1), gaussian_kl(of_mean, q), rtol=1e-10, atol=1e-12)
    assert_close(terms.spread.sum(-1), gaussian_kl(of_spread, q), rtol=1e-10, atol=1e-12)
    firsts = [torch.arange(j) for j in range(1, 5)]
    expected = torch.stack([gaussian_kl(p.marginal(j), q.marginal(j)) for j in firsts], -1)
    assert_close(both.cumsum(-1), expected, rtol=1e-10, atol=1e-10)
