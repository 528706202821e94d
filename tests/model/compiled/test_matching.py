"""Moments by the kernels against arithmetic of fifty digits, as the formulas in PyTorch are tested.

The errors are below the package's own estimate of what rounding makes of the moments.
"""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor

from tests.gp.test_moment_accuracy import errors_over_estimates
from tests.helpers.exact_moments import ExactMoments, exact, hard_problem
from torch_pmil.gp.gaussian import Gaussian, Moments
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_accuracy import rounding_errors
from torch_pmil.model.compiled.arrays import Functions, Record, Workspace
from torch_pmil.model.compiled.matching import match
from torch_pmil.model.compiled.matching_adjoints import adjoint_of_gp
from torch_pmil.model.compiled.packing import functions_of


class Match:
    """The moments of a posterior at one belief, and their adjoint."""

    def __init__(self, f: KernelExpansion, belief: Gaussian) -> None:
        prior = f.signal_variance.numpy()
        self.f: Functions = functions_of(f)._replace(variance=prior)
        self.mean, self.record = belief.mean.numpy(), Record.of(self.f, 1)
        self.work, self.cov = Workspace.of(self.f), np.empty((f.num_outputs, f.num_outputs))
        cov = belief.cov.numpy()
        assert match(self.f, self.mean, cov, self.record, 0, self.work, self.cov)

    @property
    def moments(self) -> Moments:
        mean = self.record.total[0] + self.f.offset
        return Moments(*map(torch.from_numpy, (mean, self.cov, self.record.slope[0])))

    def gradients_of_variance(self) -> tuple[Tensor, Tensor]:
        """Of the first output's variance, by mean and covariance of the belief."""
        (D, _), E = self.f.inputs.shape, len(self.cov)
        of_cov = np.zeros((E, E))
        of_cov[0, 0] = 1.0
        cotangents = np.zeros(E), of_cov, np.zeros((D, E))
        by_mean, by_cov = np.empty(D), np.empty((D, D))
        task = self.f, self.record, 0, self.mean, *cotangents, self.work
        adjoint_of_gp(*task, by_mean, by_cov)
        return torch.from_numpy(by_mean), torch.from_numpy(by_cov)


def problem(
    seed: int, most_data: int, tied: bool, **settings: tuple[float, float]
) -> tuple[tuple[Tensor, ...], Gaussian]:
    """Data and belief; ``tied`` where all outputs have the same lengthscales."""
    (inputs, targets, lengthscales, *variances), belief = hard_problem(seed, most_data, **settings)
    if tied:
        lengthscales = lengthscales[:1].expand_as(lengthscales)
    return (inputs, targets, lengthscales, *variances), belief


def errors_of(seed: int, most_data: int, tied: bool = False) -> list[float]:
    """Largest errors of mean, covariance and its slope, over their estimates."""
    data, belief = problem(seed, most_data, tied)
    f = KernelExpansion.from_data(*data)
    assert functions_of(f).tied == (tied and f.num_outputs > 1)
    return errors_over_estimates(Match(f, belief).moments, f, ExactMoments(*data), belief)


@pytest.mark.parametrize("seed", range(16))
def test_errors_are_below_their_estimates(seed: int) -> None:
    assert max(errors_of(seed, most_data=40)) < 1


def test_outputs_of_a_signal_that_is_not_finite_are_not_tied() -> None:
    (inputs, targets, lengthscales, signal, noise), _ = problem(2, 10, tied=True)
    f = KernelExpansion.from_data(inputs, targets, lengthscales, signal, noise)
    endless = replace(f, signal_variance=torch.full_like(signal, torch.inf))
    assert functions_of(f).tied and not functions_of(endless).tied


@pytest.mark.parametrize("seed", (2, 3, 6, 7, 10, 11, 14))  # of two outputs
def test_errors_of_tied_outputs_are_below_their_estimates(seed: int) -> None:
    assert max(errors_of(seed, most_data=40, tied=True)) < 1


@pytest.mark.slow
def test_errors_of_two_hundred_problems_are_below_their_estimates() -> None:
    ratios = np.array([errors_of(seed, most_data=100) for seed in range(200)])
    print("mean, covariance and slope: errors over their estimates, the largest ", ratios.max(0))
    assert ratios.max() < 1


@pytest.mark.parametrize(
    ("seed", "tied"), [(0, False), (1, False), (2, False), (2, True), (3, True), (6, True)]
)
def test_gradients_are_those_of_exact_arithmetic(seed: int, tied: bool) -> None:
    """Errors of gradients by the mean are those of the variance over a lengthscale, and of those by
    the covariance over its square.
    """
    data, belief = problem(seed, 30, tied, signal_to_noise=(250.0, 350.0))
    f, reference = KernelExpansion.from_data(*data), ExactMoments(*data)
    by_mean, by_cov = Match(f, belief).gradients_of_variance()
    step, at, cov = mpmath.mpf(10) ** -15, exact(belief.mean), exact(belief.cov)
    error, lengthscales = rounding_errors(f, belief).cov[0, 0].item(), f.lengthscales[0].tolist()
    for k in range(belief.dim):
        along = step * np.eye(belief.dim, dtype=int)[k]
        change = (reference.at(at + along, cov)[1] - reference.at(at - along, cov)[1])[0, 0]
        assert abs(by_mean[k].item() - change / (2 * step)) < error / lengthscales[k]
        widening = np.outer(along, np.eye(belief.dim, dtype=int)[k])
        change = (reference.at(at, cov + widening)[1] - reference.at(at, cov - widening)[1])[0, 0]
        assert abs(by_cov[k, k].item() - change / (2 * step)) < error / lengthscales[k] ** 2
