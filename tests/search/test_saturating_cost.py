"""The expected saturating cost, against quadrature, samples, its limits and the determinant form of
the literature.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, symmetric
from torch_pmil.search.saturating_cost import expected_saturating_cost, saturating_cost


def nodes_2d(belief: Gaussian, count: int) -> tuple[Tensor, Tensor]:
    """Gauss-Hermite nodes (count², 2) of a belief and their weights."""
    nodes, weights = (torch.as_tensor(a) for a in np.polynomial.hermite_e.hermegauss(count))
    white = torch.cartesian_prod(nodes, nodes)
    return belief.mean + white @ torch.linalg.cholesky(belief.cov).mT, torch.outer(
        weights, weights
    ).flatten() / (2 * torch.pi)


def test_cost_is_that_of_the_paper_zero_at_the_target_and_one_far_from_it() -> None:
    """Eq. 28: c(x) = 1 - exp(-|x - x_target|² / 8) of width two, here at a distance of 5."""
    residual = torch.tensor([[0.0, 0.0], [1e200, 0.0], [1.5, 2.0]], dtype=torch.float64)
    expected = [0.0, 1.0, pytest.approx(1 - np.exp(-25 / 8), rel=1e-14)]
    assert saturating_cost(residual).tolist() == expected


def test_expectation_is_that_of_quadrature(draws: Draws) -> None:
    belief = draws.belief(2)
    nodes, weights = nodes_2d(belief, 60)
    assert_close(
        expected_saturating_cost(belief), weights @ saturating_cost(nodes), rtol=1e-10, atol=0
    )


def test_expectation_is_that_of_samples(draws: Draws) -> None:
    belief = draws.belief(3, 4, scale=1.0)
    costs = saturating_cost(belief.sample(200_000, draws.generator))
    standard_error = costs.std(0) / len(costs) ** 0.5
    assert ((costs.mean(0) - expected_saturating_cost(belief)).abs() < 4 * standard_error).all()


def test_expectation_is_that_of_the_determinant_form(draws: Draws) -> None:
    """1 - |I + Sigma W|^(-1/2) exp(-d' W (I + Sigma W)^-1 d / 2), naively."""
    belief, root, target = draws.belief(5, 3), draws.normal(2, 3), draws.normal(3)
    W = root.mT @ root
    widened, delta = torch.eye(3, dtype=torch.float64) + belief.cov @ W, belief.mean - target
    exponent = torch.einsum("bi,ij,bjk,bk->b", delta, W, torch.linalg.inv(widened), delta)
    expected = 1 - torch.linalg.det(widened).rsqrt() * torch.exp(-exponent / 2)
    assert_close(
        expected_saturating_cost(belief.affine(root, -root @ target)),
        expected,
        rtol=1e-12,
        atol=1e-14,
    )


def test_zero_covariance_gives_the_cost_of_the_mean(draws: Draws) -> None:
    mean = 3 * draws.normal(10, 3)
    assert torch.equal(
        expected_saturating_cost(Gaussian(mean, torch.zeros(10, 3, 3).double())),
        saturating_cost(mean),
    )


def test_gradient_at_zero_covariance_is_half_the_curvature_of_the_cost(draws: Draws) -> None:
    """To first order in Sigma, E c(x) = c(m) + tr(c''(m) Sigma) / 2."""
    mean, cov = draws.normal(3), torch.zeros(3, 3, dtype=torch.float64, requires_grad=True)
    (d_cov,) = torch.autograd.grad(expected_saturating_cost(Gaussian(mean, cov)), cov)
    curvature = torch.autograd.functional.hessian(saturating_cost, mean)
    assert_close(symmetric(d_cov), curvature / 2, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("variance", [1e8, 1e12, 1e100, 1e300])
def test_cost_goes_to_one_as_the_covariance_grows(variance: float) -> None:
    """In one dimension at the target, 1 - (1 + S)^(-1/2)."""
    cov = torch.full((1, 1), variance, dtype=torch.float64, requires_grad=True)
    cost = expected_saturating_cost(Gaussian(torch.zeros(1, dtype=torch.float64), cov))
    assert cost.item() == pytest.approx(1 - (1 + variance) ** -0.5, rel=1e-15)
    (gradient,) = torch.autograd.grad(cost, cov)
    assert gradient.item() == pytest.approx(0.5 * (1 + variance) ** -1.5, rel=1e-12, abs=0)


@pytest.mark.parametrize("variance", [1e-6, 1.0, 1e6, 1e12])
def test_singular_covariance_is_that_of_its_own_line(draws: Draws, variance: float) -> None:
    """Along a unit vector d alone, at the target: 1 - (1 + S)^(-1/2)."""
    direction = torch.nn.functional.normalize(draws.normal(3), dim=0)
    belief = Gaussian(
        torch.zeros(3, dtype=torch.float64), variance * torch.outer(direction, direction)
    )
    expected = -np.expm1(-np.log1p(variance) / 2)
    assert expected_saturating_cost(belief).item() == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_uncertainty_costs_near_the_target_and_pays_far_from_it() -> None:
    """PILCO's exploration: where the mean is far, a wide prediction is better than a narrow one."""
    means = torch.tensor([[0.0, 0.0], [5.0, 0.0]], dtype=torch.float64)
    narrow, wide = (
        expected_saturating_cost(Gaussian(means, variance * torch.eye(2).double().expand(2, 2, 2)))
        for variance in (0.01, 1.0)
    )
    near, far = wide - narrow
    assert near > 0 > far


def test_cost_lies_between_zero_and_one(draws: Draws) -> None:
    cost = expected_saturating_cost(
        Gaussian(10 * draws.normal(100, 3), draws.cov(100, 3, scale=10))
    )
    assert ((cost > 0) & (cost <= 1)).all()


def test_gradients_are_difference_quotients(draws: Draws) -> None:
    mean, root = draws.normal(2, 3).requires_grad_(), draws.normal(2, 3, 3).requires_grad_()
    assert gradcheck(lambda m, r: expected_saturating_cost(Gaussian(m, r @ r.mT)), (mean, root))


def test_gradient_keeps_its_digits_where_the_cost_is_saturated() -> None:
    """At a distance of 12 widths the cost is 1 to the last bit, its slope r exp(-r² / 2)."""
    mean, far = (torch.tensor([r], dtype=torch.float64, requires_grad=True) for r in (12.0, 1e3))
    cov = torch.zeros(1, 1, dtype=torch.float64, requires_grad=True)
    for cost in (saturating_cost(mean), expected_saturating_cost(Gaussian(mean, cov))):
        assert cost.item() == 1
        (slope,) = torch.autograd.grad(cost, mean, retain_graph=True)
        assert slope.item() == pytest.approx(12 * np.exp(-72), rel=1e-12, abs=0)
    cost = expected_saturating_cost(Gaussian(far.expand(3), cov.expand(3, 3)))
    assert cost.item() == 1
    assert all(gradient.isfinite().all() for gradient in torch.autograd.grad(cost, (far, cov)))


def test_batch_equals_loop(draws: Draws) -> None:
    belief = draws.belief(2, 3, 4)
    together = expected_saturating_cost(belief)
    assert together.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        assert_close(together[i, j], expected_saturating_cost(belief[i, j]), rtol=1e-13, atol=0)


def test_negative_covariance_is_an_error_that_names_the_element(draws: Draws) -> None:
    belief = draws.belief(3, 2)
    belief.cov[1] = -2 * torch.eye(2)
    with pytest.raises(
        NotPositiveDefiniteError,
        match=r"covariance of residual must be positive definite, .* batch element \(1,\)",
    ):
        expected_saturating_cost(belief)
