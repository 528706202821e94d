"""Moments of sines and cosines, against quadrature, their limit, and high precision."""

from __future__ import annotations

from collections.abc import Callable

import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.textbook import hermite_grid
from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.gp.trigonometry import augment, cosines_adjoint, squash

ANGLES = torch.tensor([[1.0, 0.0], [1.0, 1.0], [0.5, -2.0]], dtype=torch.float64)
PLAIN = torch.tensor([[0.0, 1.0], [1.0, -1.0]], dtype=torch.float64)
U_MAX = torch.tensor([3.5, 2.0], dtype=torch.float64)


def augmentation(x: Tensor) -> Tensor:
    angles = x @ ANGLES.mT
    return torch.cat([x @ PLAIN.mT, angles.sin(), angles.cos()], -1)


def squashing(x: Tensor) -> Tensor:
    return U_MAX * x.sin()


def augmented(belief: Gaussian) -> tuple[Gaussian, Tensor]:
    return augment(belief, PLAIN, ANGLES)


def squashed(belief: Gaussian) -> tuple[Gaussian, Tensor]:
    result, slope = squash(belief, U_MAX)
    return result, torch.diag_embed(slope)


both = pytest.mark.parametrize(
    ("moments", "function"),
    [(augmented, augmentation), (squashed, squashing)],
    ids=["augment", "squash"],
)
Function = Callable[[Tensor], Tensor]
Moments = Callable[[Gaussian], tuple[Gaussian, Tensor]]


@both
@pytest.mark.parametrize("scale", [1e-3, 0.3, 2.0])
def test_moments_are_those_of_quadrature(
    draws: Draws, moments: Moments, function: Function, scale: float
) -> None:
    belief = draws.belief(2, scale=scale)
    x, w = hermite_grid(belief)
    y = function(x)
    mean = w @ y
    cov = (y - mean).mT @ (w[:, None] * (y - mean))
    cross_cov = (x - belief.mean).mT @ (w[:, None] * (y - mean))

    result, inv_cov_cross_cov = moments(belief)
    assert_close(result.mean, mean, rtol=0, atol=1e-10)
    assert_close(result.cov, cov, rtol=0, atol=1e-10)
    assert_close(belief.cov @ inv_cov_cross_cov, cross_cov, rtol=0, atol=1e-10)


@both
def test_zero_covariance_is_the_function_and_its_gradient(
    draws: Draws, moments: Moments, function: Function
) -> None:
    x = draws.normal(2)
    result, slope = moments(Gaussian(x, torch.zeros(2, 2, dtype=torch.float64)))
    assert_close(result.mean, function(x))
    assert_close(result.cov, torch.zeros_like(result.cov))
    assert_close(slope, torch.autograd.functional.jacobian(function, x).mT)


@both
def test_gradient(draws: Draws, moments: Moments, function: Function) -> None:
    belief = draws.belief(3, 2)

    def parts(mean: Tensor, root: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        result, slope = moments(Gaussian(mean, root @ root.mT))
        return result.mean, result.cov, slope

    root = torch.linalg.cholesky(belief.cov)
    assert gradcheck(parts, (belief.mean.requires_grad_(), root.requires_grad_()))


@both
def test_batch_is_a_loop(draws: Draws, moments: Moments, function: Function) -> None:
    beliefs = draws.belief(2, 3, 2)
    together, slopes = moments(beliefs)
    for index in np.ndindex(2, 3):
        alone, slope = moments(beliefs[index])
        assert_close(together[index].mean, alone.mean)
        assert_close(together[index].cov, alone.cov)
        assert_close(slopes[index], slope)


@both
@pytest.mark.parametrize("scale", [1e-12, 1.0, 100.0])
def test_covariance_is_symmetric_and_positive_semidefinite(
    draws: Draws, moments: Moments, function: Function, scale: float
) -> None:
    result, _ = moments(draws.belief(20, 2, scale=scale))
    assert_close(result.cov, result.cov.mT)
    assert torch.linalg.eigvalsh(result.cov / result.cov.abs().max()).min() > -1e-12


@pytest.mark.parametrize("variance", [1e-14, 1e-8, 1e-2, 1.0])
def test_tiny_variances_keep_their_digits(variance: float) -> None:
    """Var sin = (1 - exp(-v)) (1 + exp(-v) cos 2m) / 2 and cov(x, sin) = v exp(-v/2) cos m, in 50
    digits.
    """
    m = 0.7
    with mpmath.workdps(50):
        v = mpmath.mpf(variance)
        decay, twice = mpmath.exp(-v), 2 * mpmath.mpf(m)
        var_sin = float((1 - decay) * (1 + decay * mpmath.cos(twice)) / 2)
        cov_sin_cos = float(-(1 - decay) * decay * mpmath.sin(twice) / 2)
        cov_x_sin = float(v * mpmath.exp(-v / 2) * mpmath.cos(m))
    one = torch.ones(1, 1, dtype=torch.float64)
    cov = augment(Gaussian(m * one[0], variance * one), one, one)[0].cov  # of x, sin, cos
    assert cov[1, 1].item() == pytest.approx(var_sin, rel=1e-13)
    assert cov[1, 2].item() == pytest.approx(cov_sin_cos, rel=1e-13)
    assert cov[0, 1].item() == pytest.approx(cov_x_sin, rel=1e-13)


def test_wide_belief_spreads_over_the_circle() -> None:
    one = torch.ones(1, 1, dtype=torch.float64)
    variance = (1e4 * one).requires_grad_()
    result, slope = augment(Gaussian(one[0], variance), one, one)
    assert_close(result.mean[1:], torch.zeros(2, dtype=torch.float64))
    assert_close(result.cov[1:, 1:], 0.5 * torch.eye(2, dtype=torch.float64))
    (result.mean.sum() + result.cov.sum() + slope.sum()).backward()
    assert variance.grad.isfinite().all()


def test_no_angles_leave_the_belief_as_it_is(draws: Draws) -> None:
    belief = draws.belief(3)
    identity = torch.eye(3, dtype=torch.float64)
    result, slope = augment(belief, identity, torch.zeros(0, 3, dtype=torch.float64))
    assert_close(result.mean, belief.mean)
    assert_close(result.cov, belief.cov)
    assert torch.equal(slope, identity)


# --- limits that lose digits ---


@pytest.mark.parametrize("variance", [1e-12, 1e-8, 1e-4, 1.0])
@pytest.mark.parametrize("quarters", [0, 1, 2])
def test_cosine_at_its_summit_keeps_its_digits(variance: float, quarters: int) -> None:
    """Where its slope is zero its variance is (1 - exp(-v))^2 / 2, which is about v^2 / 2, and that
    of the sine sinh(v) exp(-v).
    """
    one, m = torch.ones(1, 1, dtype=torch.float64), quarters * torch.pi / 2
    with mpmath.workdps(50):
        v = mpmath.mpf(variance)
        at_summit = float((1 - mpmath.exp(-v)) ** 2 / 2)
        across = float(mpmath.sinh(v) * mpmath.exp(-v))
    result, _ = augment(Gaussian(m * one[0], variance * one), one[:0], one)
    sine, cosine = result.cov.diagonal().tolist()
    flat, steep = (sine, cosine) if quarters == 1 else (cosine, sine)
    assert flat == pytest.approx(at_summit, rel=1e-12, abs=0)
    assert steep == pytest.approx(across, rel=1e-12, abs=0)


@pytest.mark.parametrize("variance", [1e-12, 1e-8, 1e-4])
def test_two_cosines_at_their_summits_keep_their_digits(variance: float) -> None:
    """cov(cos a, cos b) = exp(-(v_a + v_b) / 2) (cosh v_ab - 1) at a = b = 0, through the squashing
    at a quarter turn.
    """
    V = variance * torch.tensor([[2.0, -0.7], [-0.7, 1.5]], dtype=torch.float64)
    with mpmath.workdps(50):
        v_a, v_b, v_ab = (mpmath.mpf(V[index].item()) for index in ((0, 0), (1, 1), (0, 1)))
        expected = float(mpmath.exp(-(v_a + v_b) / 2) * (mpmath.cosh(v_ab) - 1))
    quarter = torch.full((2,), torch.pi / 2, dtype=torch.float64)
    cov = squash(Gaussian(quarter, V), U_MAX)[0].cov / (U_MAX[:, None] * U_MAX)
    assert cov[0, 1].item() == pytest.approx(expected, rel=1e-12, abs=0)
    assert cov[0, 1] == cov[1, 0]


@pytest.mark.parametrize("variance", [1e4, 1e8])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_angles_that_turn_together_stay_correlated_however_wide(
    draws: Draws, variance: float, sign: float
) -> None:
    """b = sign a up to a constant: cov(cos a, cos b) -> cos(m_a - sign m_b) / 2, means -> 0,
    variances -> 1/2.
    """
    m = draws.normal(2).requires_grad_()
    V = (variance * torch.tensor([[1.0, sign], [sign, 1.0]], dtype=torch.float64)).requires_grad_()
    result, slope = squash(Gaussian(m + torch.pi / 2, V), torch.ones(2, dtype=torch.float64))
    assert_close(result.mean, torch.zeros(2, dtype=torch.float64))
    assert_close(slope, torch.zeros(2, dtype=torch.float64))
    assert_close(result.cov.diagonal(), torch.full((2,), 0.5, dtype=torch.float64))
    assert_close(result.cov[0, 1], torch.cos(m[0] - sign * m[1]) / 2)
    d_m, d_V = torch.autograd.grad(result.cov[0, 1] + result.mean.sum() + slope.sum(), (m, V))
    change = torch.sin(m[0] - sign * m[1]) / 2
    assert_close(d_m, torch.stack([-change, sign * change]))
    assert d_V.isfinite().all()


# --- adjoints ---


def naive_cosines(m: Tensor, V: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, covariance and mean slope of the cosines of phases, as the formulas are written."""
    decay = torch.exp(-V.diagonal(dim1=-2, dim2=-1) / 2)
    cos_cos, sin_sin = (f(m)[..., :, None] * f(m)[..., None, :] for f in (torch.cos, torch.sin))
    cov = (
        decay[..., :, None]
        * decay[..., None, :]
        * ((torch.cosh(V) - 1) * cos_cos + torch.sinh(V) * sin_sin)
    )
    return decay * m.cos(), cov, -decay * m.sin()


@pytest.mark.parametrize("scale", [1e-6, 0.5])
@pytest.mark.parametrize("copies", [1, 4])
def test_adjoint_is_that_of_the_graph_for_every_copy(
    draws: Draws, scale: float, copies: int
) -> None:
    belief = draws.belief(3, 3, scale=scale)
    leaves = [t.clone().requires_grad_() for t in (belief.mean, belief.cov)]
    result = naive_cosines(*leaves)
    d_mean, d_cov, d_slope = (draws.normal(3, copies, *part.shape[1:]) for part in result)
    d_cov = symmetric(d_cov)
    ours = cosines_adjoint(belief.mean[:, None], belief.cov[:, None], d_mean, d_cov, d_slope)
    assert ours[0].shape == (3, copies, 3) and ours[1].shape == (3, copies, 3, 3)
    assert_close(ours[1], ours[1].mT, rtol=1e-13, atol=1e-13)
    for c in range(copies):
        by_mean, by_cov = torch.autograd.grad(
            result, leaves, (d_mean[:, c], d_cov[:, c], d_slope[:, c]), retain_graph=True
        )
        assert_close(ours[0][:, c], by_mean, rtol=1e-9, atol=1e-9)
        assert_close(ours[1][:, c], symmetric(by_cov), rtol=1e-9, atol=1e-9)
