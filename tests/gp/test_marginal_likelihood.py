"""The marginal likelihood against GPyTorch's and the density, its gradient against differences."""

from __future__ import annotations

import gpytorch
import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.exact_gps import ExactGP, exact_gp_of
from torch_pmil.gp.gaussian import NotPositiveDefiniteError
from torch_pmil.gp.marginal_likelihood import negative_log_likelihood


def log_parameters(draws: Draws, D: int) -> Tensor:
    """Lengthscales, signal and noise variance of sizes that a fit meets."""
    return torch.cat([draws.uniform(-0.5, 2, D), draws.uniform(-3, 1, 1), draws.uniform(-8, -2, 1)])


def model_of(inputs: Tensor, target: Tensor, log_parameters: Tensor) -> ExactGP:
    """GPyTorch's model of one output, with the hyper-parameters of a vector (D + 2,)."""
    above_zero = gpytorch.constraints.GreaterThan(0)
    model = exact_gp_of(inputs, target, noise_constraint=above_zero).double()
    model.covar_module.base_kernel.lengthscale = log_parameters[:-2].exp()
    model.covar_module.outputscale, model.likelihood.noise = log_parameters[-2:].exp()
    return model


def of_gpytorch(inputs: Tensor, target: Tensor, parameters: Tensor) -> tuple[Tensor, Tensor]:
    """Value, and gradient by automatic differentiation with respect to the logarithms."""
    model = model_of(inputs, target, parameters)
    with gpytorch.settings.fast_computations(
        covar_root_decomposition=False, log_prob=False, solves=False
    ):
        mean_log_likelihood = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)(
            model(inputs), target
        )
    loss = -len(target) * mean_log_likelihood
    kernel, noise = model.covar_module, model.likelihood.noise_covar
    raw = [kernel.base_kernel.raw_lengthscale, kernel.raw_outputscale, noise.raw_noise]
    gradients = torch.autograd.grad(loss, raw)
    # of softplus: dv/draw = 1 - exp(-v), d/dlog v = v d/dv
    values = [kernel.base_kernel.lengthscale, kernel.outputscale, noise.noise]
    chained = [
        (g * v / (1 - torch.exp(-v))).flatten() for g, v in zip(gradients, values, strict=True)
    ]
    return loss.detach(), torch.cat(chained).detach()


def plain(inputs: Tensor, target: Tensor, parameters: Tensor) -> tuple[Tensor, Tensor]:
    """Value from the density of the data, and gradient by automatic differentiation."""
    parameters = parameters.clone().requires_grad_()
    z = inputs / parameters[:-2].exp()
    squared_distances = (z[:, None] - z).square().sum(-1)
    gram = torch.exp(parameters[-2] - squared_distances / 2)
    noise = parameters[-1].exp() * torch.eye(len(target), dtype=torch.float64)
    loss = -torch.distributions.MultivariateNormal(0 * target, gram + noise).log_prob(target)
    return loss.detach(), *torch.autograd.grad(loss, parameters)


@pytest.mark.parametrize(("n", "D"), [(1, 1), (2, 3), (40, 2), (120, 8)])
def test_value_and_gradient_are_those_of_gpytorch_and_of_the_density(
    draws: Draws, n: int, D: int
) -> None:
    inputs, target = draws.normal(n, D), draws.normal(n)
    for _ in range(5):
        parameters = log_parameters(draws, D)
        value, gradient = negative_log_likelihood(inputs, target, parameters)
        for expected, expected_gradient in (
            of_gpytorch(inputs, target, parameters),
            plain(inputs, target, parameters),
        ):
            assert value == pytest.approx(expected.item(), rel=1e-9, abs=1e-9)
            largest = expected_gradient.abs().max().item()
            torch.testing.assert_close(gradient, expected_gradient, rtol=1e-8, atol=1e-9 * largest)


def test_offset_of_the_inputs_does_not_matter(draws: Draws) -> None:
    inputs, target, parameters = draws.normal(30, 3), draws.normal(30), log_parameters(draws, 3)
    expected, _ = negative_log_likelihood(inputs, target, parameters)
    value, _ = negative_log_likelihood(inputs + 1e6, target, parameters)
    assert value == pytest.approx(expected, rel=1e-6)


def test_data_are_left_as_they_were(draws: Draws) -> None:
    data = draws.normal(5, 2), draws.normal(5), log_parameters(draws, 2)
    before = [tensor.clone() for tensor in data]
    negative_log_likelihood(*data)
    assert all(torch.equal(tensor, kept) for tensor, kept in zip(data, before, strict=True))


def test_gram_matrix_without_cholesky_factor_is_an_error_not_jittered(draws: Draws) -> None:
    """Two data at the same place, without noise."""
    parameters = torch.tensor([0.0, 0.0, 0.0, -1000.0], dtype=torch.float64)
    with pytest.raises(NotPositiveDefiniteError, match="Gram matrix must be positive definite"):
        negative_log_likelihood(draws.normal(1, 2).expand(2, 2), draws.normal(2), parameters)
