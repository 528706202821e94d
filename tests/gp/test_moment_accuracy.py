"""Estimates of rounding errors against arithmetic of fifty digits, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.exact_moments import ExactMoments, exact, hard_problem, inverse
from tests.helpers.sampled_moments import sampled_moments
from torch_pmil.gp import moment_matching
from torch_pmil.gp.gaussian import Gaussian, Moments
from torch_pmil.gp.gaussian_integrals import GaussianIntegrals
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_accuracy import (
    InaccurateMomentsError,
    check_variances,
    condition_number,
    rounding_errors,
    signal_to_noise,
)
from torch_pmil.gp.moment_matching import moment_match


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is refused."""
    monkeypatch.setattr(moment_matching, "check_variances", lambda *_: None)


def errors_over_estimates(moments: Moments, f: KernelExpansion, reference, belief) -> list[float]:
    """Largest errors of mean, covariance and its slope, over their estimates."""
    estimates = rounding_errors(f, belief)
    pairs = zip(
        (moments.mean, moments.cov, moments.inv_cov_cross_cov),
        (estimates.mean, estimates.cov, estimates.inv_cov_cross_cov),
        reference.at_belief(belief),
        strict=True,
    )
    return [
        float(max((abs(exact(ours) - truth) / exact(estimate)).flat))
        for ours, estimate, truth in pairs
    ]


def assert_estimates_hold(seed: int, most_data: int) -> None:
    data, belief = hard_problem(seed, most_data)
    f = KernelExpansion.from_data(*data)
    moments = moment_match(f, belief)
    assert max(errors_over_estimates(moments, f, ExactMoments(*data), belief)) < 1


@pytest.mark.parametrize("seed", range(16))
def test_errors_are_below_their_estimates(unchecked: None, seed: int) -> None:
    assert_estimates_hold(seed, most_data=40)


def test_error_far_from_all_data_is_below_its_estimate(unchecked: None, draws: Draws) -> None:
    """There the variance is the prior's, as rounded."""
    x, one = draws.normal(5, 1), torch.ones(1, dtype=torch.float64)
    data = x, draws.normal(1, 5), one[:, None], 0.1 * one, 1e-6 * one
    f, far = KernelExpansion.from_data(*data), wide(torch.full((1,), 40.0, dtype=torch.float64))
    assert max(errors_over_estimates(moment_match(f, far), f, ExactMoments(*data), far)) < 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 2000))
def test_errors_of_a_thousand_problems_are_below_their_estimates(
    unchecked: None, seed: int
) -> None:
    assert_estimates_hold(seed, most_data=150)


SAMPLES = 10**6


def assert_samples_agree(seed: int, most_data: int) -> None:
    """Six standard errors apart at most, beside the rounding of both sides."""
    data, belief = hard_problem(seed, most_data)
    f = KernelExpansion.from_data(*data)
    moments, rounding = moment_match(f, belief), rounding_errors(f, belief)
    (mean, mean_error), (cov, cov_error) = sampled_moments(*data, belief, SAMPLES, Draws(seed))
    assert ((moments.mean - mean).abs() < 6 * mean_error + 2 * rounding.mean).all()
    assert ((moments.cov - cov).abs() < 6 * cov_error + 2 * rounding.cov).all()


@pytest.mark.parametrize("seed", range(4))
def test_moments_are_those_of_samples(unchecked: None, seed: int) -> None:
    assert_samples_agree(seed, most_data=30)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 2000))
def test_moments_of_a_thousand_problems_are_those_of_samples(unchecked: None, seed: int) -> None:
    assert_samples_agree(seed, most_data=150)


def test_estimates_are_no_more_than_some_hundred_times_the_errors(unchecked: None) -> None:
    ratios = []
    for seed in range(12):
        data, belief = hard_problem(seed, most_data=30)
        f = KernelExpansion.from_data(*data)
        ratios.append(
            errors_over_estimates(moment_match(f, belief), f, ExactMoments(*data), belief)[1]
        )
    assert np.median(ratios) > 1 / 300


@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_that_of_exact_arithmetic(seed: int) -> None:
    data, belief = hard_problem(seed, 30, signal_to_noise=(250.0, 350.0))
    f, reference = KernelExpansion.from_data(*data), ExactMoments(*data)
    mean = belief.mean.clone().requires_grad_()
    variance = moment_match(f, Gaussian(mean, belief.cov)).cov[0, 0]
    (gradient,) = torch.autograd.grad(variance, mean)
    step = mpmath.mpf(10) ** -15
    at, cov = exact(belief.mean), exact(belief.cov)
    allowed = rounding_errors(f, belief).cov[0, 0] / f.lengthscales[0]
    for k in range(belief.dim):
        along = step * np.eye(belief.dim, dtype=int)[k]
        change = (reference.at(at + along, cov)[1] - reference.at(at - along, cov)[1])[0, 0]
        assert abs(gradient[k].item() - change / (2 * step)) < allowed[k].item()


def test_exact_inverse_is_that_of_mpmath(draws: Draws) -> None:
    matrix = exact(draws.cov(6, scale=1.0))
    expected = np.array((mpmath.matrix(matrix.tolist()) ** -1).tolist(), dtype=object)
    assert max(abs(inverse(matrix) - expected.reshape(6, 6)).flat) < 1e-40


# --- refusals ---


def ill_conditioned(draws: Draws, noise: float, n: int = 80) -> KernelExpansion:
    """Two outputs with signal variance 1; the second is a sine too fast for its kernel."""
    x = draws.uniform(-2, 2, n, 1)
    y = torch.stack([0 * x[:, 0], 3 * (9 * x[:, 0]).sin()])
    one = torch.ones(2, dtype=torch.float64)
    return KernelExpansion.from_data(x, y, one[:, None], one, noise * one)


def wide(mean: Tensor) -> Gaussian:
    return Gaussian(mean, 0.1 * torch.eye(1, dtype=torch.float64).expand(*mean.shape, 1))


def test_variance_below_its_error_is_refused_by_name(draws: Draws) -> None:
    f = ill_conditioned(draws, noise=1e-6)
    with pytest.raises(InaccurateMomentsError) as error:
        moment_match(f, wide(torch.zeros(1, dtype=torch.float64)))
    message = str(error.value)
    assert message.startswith("variance of output 1 must exceed its rounding error")
    assert "signal-to-noise ratio 1e+03" in message and "\n" not in message
    assert error.value.element == (0, 1)


def test_more_noise_is_what_helps(draws: Draws) -> None:
    f = ill_conditioned(draws, noise=1e-2)
    variances = moment_match(f, wide(torch.zeros(1, dtype=torch.float64))).cov.diagonal()
    assert (variances > 0).all()


def test_refusal_names_the_belief_of_a_batch(draws: Draws) -> None:
    f, far = ill_conditioned(draws, noise=1e-6), torch.tensor([[40.0], [0.0]], dtype=torch.float64)
    with pytest.raises(InaccurateMomentsError, match="at belief 1 of 2"):
        moment_match(f, wide(far))


def test_noise_of_an_observation_counts(draws: Draws) -> None:
    x, one = draws.normal(20, 1), torch.ones(1, dtype=torch.float64)
    f = KernelExpansion.from_data(x, x.mT.sin(), one[:, None], one, 1e-9 * one)
    observed = replace(f, noise_variance=one)
    belief = Gaussian(x[0], torch.zeros(1, 1, dtype=torch.float64))
    with pytest.raises(InaccurateMomentsError):
        moment_match(f, belief)
    assert moment_match(observed, belief, observation_noise=True).cov > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_what_passes_the_bound_of_linear_work_passes_the_estimate(
    unchecked: None, seed: int
) -> None:
    for number in range(20):
        data, belief = hard_problem(100 * seed + number, 60)
        f = KernelExpansion.from_data(*data)
        variances = moment_match(f, belief).cov.diagonal()[None]
        integrals = GaussianIntegrals.of(f, belief.flattened)
        errors = rounding_errors(f, belief).cov.diagonal()
        try:
            check_variances(f, integrals, variances)
        except InaccurateMomentsError:
            assert not (variances > errors).all()
        else:
            assert (variances > errors).all()


def test_network_at_a_point_has_no_variance_within_its_estimate(draws: Draws) -> None:
    f = draws.network(20, 3, 2)
    f = replace(f, weights=1e3 * f.weights)
    point = Gaussian(draws.normal(4, 3), torch.zeros(4, 3, 3, dtype=torch.float64))
    assert (moment_match(f, point).cov.abs() <= rounding_errors(f, point).cov).all()


def test_estimates_of_a_batch_are_those_of_each(
    draws: Draws, monkeypatch: pytest.MonkeyPatch
) -> None:
    f, belief = draws.gp(7, 3, 2), draws.belief(2, 4, 3)
    together, moments = rounding_errors(f, belief), moment_match(f, belief)
    for name in ("mean", "cov", "inv_cov_cross_cov"):
        assert getattr(together, name).shape == getattr(moments, name).shape
    assert_close(together.cov, together.cov.mT)
    monkeypatch.setattr("torch_pmil.gp.moment_accuracy.LARGEST_ARRAY", 1)
    assert_close(rounding_errors(f, belief).cov, together.cov)


def test_condition_number_is_that_of_the_gram_matrix(draws: Draws) -> None:
    x, one = draws.normal(2, 9, 1), torch.ones(2, dtype=torch.float64)
    f = KernelExpansion.from_data(x, draws.normal(2, 9), one[:, None], one, 0.1 * one)
    for output in range(2):
        gram = torch.exp(-(x[output] - x[output].mT).square() / 2) + 0.1 * torch.eye(9)
        expected = torch.linalg.cond(gram.double()).item()
        assert condition_number(f, output) == pytest.approx(expected, rel=1e-6)
    assert_close(signal_to_noise(f), 10**0.5 * one)
