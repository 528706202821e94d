"""Expansions in squared exponentials, against the formula kernel by kernel and GPyTorch's
posterior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import exp

import gpytorch
import pytest
import torch
from gpytorch.means import ConstantMean
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.exact_gps import exact_gp_of
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_matching import moment_match

both = pytest.mark.parametrize("make", [Draws.gp, Draws.network])
Make = Callable[[Draws, int, int, int], KernelExpansion]
FAR = 2.0**20  # moves numbers of at most 32 binary places without rounding


def naive_kernel(f: KernelExpansion, a: int, x: Tensor, y: Tensor) -> float:
    """Eq. 5 at two points (D,)."""
    squares = sum(((x[d] - y[d]) / f.lengthscales[a, d]).item() ** 2 for d in range(f.num_inputs))
    return f.signal_variance[a].item() * exp(-squares / 2)


def naive_kernels(f: KernelExpansion, x: Tensor) -> Tensor:
    """Of all outputs and inputs at one point, (E, n)."""
    return torch.tensor(
        [[naive_kernel(f, a, x, y) for y in f.inputs] for a in range(f.num_outputs)],
        dtype=torch.float64,
    )


# --- values ---


@both
def test_kernel_and_mean_are_the_formula(draws: Draws, make: Make) -> None:
    f, x = make(draws, 6, 3, 2), draws.normal(2, 4, 3)
    f = replace(f, signal_variance=draws.uniform(0.5, 2.0, 2), offset=draws.normal(2))
    kernel, mean = f.kernel(x), f.mean(x)
    assert kernel.shape == (2, 4, 2, 6) and mean.shape == (2, 4, 2)
    for index in range(8):
        i, j = divmod(index, 4)
        expected = naive_kernels(f, x[i, j])
        assert_close(kernel[i, j], expected, rtol=1e-13, atol=0)
        assert_close(mean[i, j], (expected * f.weights).sum(-1) + f.offset, rtol=1e-12, atol=1e-12)


def test_prediction_is_the_posterior_written_with_the_whole_gram_matrix(draws: Draws) -> None:
    """Eqs. 6 and 7."""
    f, targets, x = draws.gp(8, 2, 3), draws.normal(3, 8), draws.normal(5, 2)
    f = KernelExpansion.from_data(
        f.inputs, targets, f.lengthscales, f.signal_variance, f.noise_variance, f.offset
    )
    mean, variance = f.predict(x)
    assert_close(mean, f.mean(x))
    for a in range(3):
        eye = torch.eye(8, dtype=torch.float64)
        gram = torch.stack([naive_kernels(f, y)[a] for y in f.inputs]) + f.noise_variance[a] * eye
        k = torch.stack([naive_kernels(f, point)[a] for point in x])  # (5, 8)
        assert_close(f.gram_inverse[a] @ gram, eye)
        assert_close(
            mean[:, a], f.offset[a] + k @ torch.linalg.solve(gram, targets[a] - f.offset[a])
        )
        assert_close(
            variance[:, a], f.signal_variance[a] - (k * torch.linalg.solve(gram, k.mT).mT).sum(-1)
        )


def test_network_is_certain(draws: Draws) -> None:
    f, x = draws.network(6, 2, 3), draws.normal(4, 2)
    mean, variance = f.predict(x)
    assert_close(mean, f.mean(x))
    assert torch.equal(variance, torch.zeros(4, 3, dtype=torch.float64))


def test_posterior_far_from_the_data_is_the_prior(draws: Draws) -> None:
    f = draws.gp(6, 2, 2)
    mean, variance = f.predict(torch.full((1, 2), 1e4, dtype=torch.float64))
    assert torch.equal(mean[0], f.offset)
    assert torch.equal(variance[0], f.signal_variance)


# --- inputs of the outputs' own ---


def test_outputs_with_own_inputs_are_expansions_of_their_own(draws: Draws) -> None:
    E, n, D = 3, 6, 2
    gp, inputs, targets = draws.gp(n, D, E), draws.normal(E, n, D), draws.normal(E, n)
    hyperparameters = gp.lengthscales, gp.signal_variance, gp.noise_variance, gp.offset
    together = KernelExpansion.from_data(inputs, targets, *hyperparameters)
    assert together.inputs.shape == (E * n, D) and together.gram_inverse.shape == (E, E * n, E * n)
    x, belief = draws.normal(4, D), draws.belief(2, D)
    mean, variance = together.predict(x)
    moments = moment_match(together, belief, observation_noise=True)
    for a in range(E):
        alone = KernelExpansion.from_data(
            inputs[a], targets[a : a + 1], *(parameter[a : a + 1] for parameter in hyperparameters)
        )
        for ours, expected in zip((mean, variance), alone.predict(x), strict=True):
            assert_close(ours[:, a], expected[:, 0], rtol=1e-11, atol=1e-11)
        expected = moment_match(alone, belief, observation_noise=True)
        assert_close(moments.mean[:, a], expected.mean[:, 0], rtol=1e-11, atol=1e-11)
        close = {"rtol": 1e-10, "atol": 1e-10}
        assert_close(moments.cov[:, a, a], expected.cov[:, 0, 0], **close)
        slope, wanted = (each.inv_cov_cross_cov for each in (moments, expected))
        assert_close(slope[..., a], wanted[..., 0], **close)


def test_own_inputs_that_are_the_same_are_shared_ones(draws: Draws) -> None:
    gp, targets, x = draws.gp(6, 2, 2), draws.normal(2, 6), draws.normal(4, 2)
    hyperparameters = gp.lengthscales, gp.signal_variance, gp.noise_variance, gp.offset
    shared = KernelExpansion.from_data(gp.inputs, targets, *hyperparameters)
    own = KernelExpansion.from_data(gp.inputs.expand(2, 6, 2), targets, *hyperparameters)
    for one, other in zip(shared.predict(x), own.predict(x), strict=True):
        assert_close(one, other, rtol=1e-11, atol=1e-11)
    belief = draws.belief(2)
    assert_close(
        moment_match(own, belief).cov, moment_match(shared, belief).cov, rtol=1e-10, atol=1e-10
    )


# --- inputs far from zero ---


def dyadic(values: Tensor) -> Tensor:
    """Rounded to 20 binary places, so that :data:`FAR` can be added without rounding."""
    return (values * 2**20).round() / 2**20


@pytest.mark.parametrize("own_inputs", [False, True], ids=["shared inputs", "own inputs"])
def test_inputs_far_from_zero_fit_as_well_as_centred_ones(draws: Draws, own_inputs: bool) -> None:
    gp, targets, x = draws.gp(10, 2, 2), draws.normal(2, 10), dyadic(draws.normal(4, 2))
    inputs = dyadic(draws.normal(2, 10, 2) if own_inputs else gp.inputs)
    kernel = gp.lengthscales, gp.signal_variance, gp.noise_variance
    near, far = (
        KernelExpansion.from_data(inputs + offset, targets, *kernel) for offset in (0.0, FAR)
    )
    assert_close(far.weights, near.weights, rtol=1e-9, atol=1e-9)
    assert_close(far.gram_inverse, near.gram_inverse, rtol=1e-9, atol=1e-9)
    for ours, expected in zip(far.predict(x + FAR), near.predict(x), strict=True):
        assert_close(ours, expected, rtol=1e-9, atol=1e-9)
    cov = draws.cov(4, 2)
    moments = moment_match(far, Gaussian(x + FAR, cov))
    expected = moment_match(near, Gaussian(x, cov))
    assert_close(moments.mean, expected.mean, rtol=1e-9, atol=1e-9)
    assert_close(moments.cov, expected.cov, rtol=1e-9, atol=1e-9)


# --- GPyTorch's models ---


def exact_gp(draws: Draws, own_inputs: bool = False) -> gpytorch.models.ExactGP:
    """Two outputs with constant means: hyper-parameters in float32 and data in float64."""
    inputs = draws.normal(2, 9, 2) if own_inputs else draws.normal(9, 2).expand(2, 9, 2)
    model = exact_gp_of(inputs, draws.normal(2, 9), ConstantMean)
    model.covar_module.base_kernel.lengthscale = draws.uniform(0.7, 2.0, 2, 1, 2)
    model.covar_module.outputscale = draws.uniform(0.5, 2.0, 2)
    model.likelihood.noise = draws.uniform(0.01, 0.1, 2, 1)
    model.mean_module.constant.data.copy_(draws.normal(2))
    return model.eval()


@pytest.mark.parametrize("own_inputs", [False, True], ids=["shared inputs", "own inputs"])
def test_single_precision_hyperparameters_serve_data_in_double_precision(
    draws: Draws, own_inputs: bool
) -> None:
    """The expansion is that of the same numbers in double precision, and GPyTorch's posterior."""
    model, x = exact_gp(draws, own_inputs), draws.normal(4, 2)
    assert {parameter.dtype for parameter in model.parameters()} == {torch.float32}
    single = KernelExpansion.from_exact_gp(model)
    assert {t.dtype for t in vars(single).values()} == {torch.float64}
    assert len(single.inputs) == (18 if own_inputs else 9)

    double = exact_gp_of(model.train_inputs[0], model.train_targets, ConstantMean).double().eval()
    kernel, its = double.covar_module, model.covar_module
    kernel.base_kernel.lengthscale = its.base_kernel.lengthscale.double()
    kernel.outputscale = its.outputscale.double()
    double.likelihood.noise = model.likelihood.noise.double()
    double.mean_module.constant.data.copy_(model.mean_module.constant.data)
    posterior = double(x.expand(2, 4, 2))
    for ours, same, theirs in zip(
        single.predict(x),
        KernelExpansion.from_exact_gp(double).predict(x),
        (posterior.mean, posterior.variance),
        strict=True,
    ):
        assert_close(ours, same, rtol=1e-10, atol=1e-10)
        assert_close(ours, theirs.mT, rtol=1e-8, atol=1e-8)


# --- arguments ---


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inputs": [[0.0], [torch.inf]]}, "inputs must be finite, got inf"),
        ({"targets": [0.0, 0.0]}, r"targets must have shape \(E, n\), got \(2,\)"),
        ({"lengthscales": [1.0, 1.0]}, r"lengthscales must have shape \(2, 1\)"),
        ({"offset": [torch.nan, 0.0]}, "offset must be finite"),
    ],
)
def test_data_that_do_not_fit_are_errors(changes: dict, message: str) -> None:
    one = [1.0, 1.0]
    data = {"inputs": [[0.0], [1.0]], "targets": [one, one], "lengthscales": [[1.0], [1.0]]}
    arguments = data | {"signal_variance": one, "noise_variance": one} | changes
    tensors = {n: torch.tensor(values, dtype=torch.float64) for n, values in arguments.items()}
    with pytest.raises(ValueError, match=message):
        KernelExpansion.from_data(**tensors)


@pytest.mark.parametrize("own_inputs", [False, True], ids=["shared inputs", "own inputs"])
def test_singular_gram_matrix_is_an_error_that_names_the_output(
    draws: Draws, own_inputs: bool
) -> None:
    zeros = torch.zeros(3, 1, dtype=torch.float64)
    inputs = torch.stack([draws.normal(3, 1), zeros]) if own_inputs else zeros
    one, noise = torch.ones(2, dtype=torch.float64), torch.tensor([1.0, 0.0], dtype=torch.float64)
    with pytest.raises(NotPositiveDefiniteError, match=r"Gram matrix .* batch element \(1,\)"):
        KernelExpansion.from_data(inputs, draws.normal(2, 3), one[:, None], one, noise)
