"""The posterior at particles is that of the expansion, and so is its gradient."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from reproduction.baselines.particle_posterior import ParticlePosterior
from tests.helpers.draws import Draws
from torch_pmil.gp.kernel_expansion import KernelExpansion


@pytest.fixture
def expansion(draws: Draws) -> KernelExpansion:
    """Two outputs of three inputs, with twelve data; noise keeps K well conditioned."""
    inputs, targets = draws.normal(12, 3), draws.normal(2, 12)
    lengthscales = 1 + draws.normal(2, 3).abs()
    signal = torch.tensor([0.5, 4.0], dtype=torch.float64)
    return KernelExpansion.from_data(inputs, targets, lengthscales, signal, 0.01 * signal, 0.3)


def test_value_and_gradient_are_those_of_the_expansion(
    expansion: KernelExpansion, draws: Draws
) -> None:
    x, of_mean, of_variance = draws.normal(7, 3), draws.normal(7, 2), draws.normal(7, 2)

    def outcome(predicted: tuple[Tensor, Tensor], at: Tensor) -> tuple[Tensor, ...]:
        mean, variance = predicted
        combined = (of_mean * mean).sum() + (of_variance * variance).sum()
        return mean, variance, *torch.autograd.grad(combined, at)

    ours, theirs = x.clone().requires_grad_(), x.clone().requires_grad_()
    found = outcome(ParticlePosterior(expansion).predict(ours), ours)
    for one, other in zip(found, outcome(expansion.predict(theirs), theirs), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


def test_gradient_is_that_of_differences_and_far_from_data_nothing_is_explained(
    expansion: KernelExpansion, draws: Draws
) -> None:
    predict = ParticlePosterior(expansion).predict
    assert torch.autograd.gradcheck(predict, (draws.normal(4, 3).requires_grad_(),))
    mean, variance = predict(torch.full((1, 3), 1e3, dtype=torch.float64))
    assert torch.equal(mean, torch.full_like(mean, 0.3))
    assert torch.equal(variance, expansion.signal_variance[None])
