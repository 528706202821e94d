"""Moments at a Gaussian input, against Eqs. 14-18 written naively, quadrature, and GPyTorch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from gpytorch.kernels import MaternKernel, RBFKernel, ScaleKernel
from gpytorch.likelihoods import FixedNoiseGaussianLikelihood
from gpytorch.means import ConstantMean, LinearMean, Mean, ZeroMean
from torch import Tensor
from torch.autograd import gradcheck
from torch.autograd.graph import saved_tensors_hooks
from torch.nn import Module
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.exact_gps import ExactGP, exact_gp_of
from tests.helpers.textbook import hermite_grid, textbook_Q, textbook_q
from torch_pmil.gp.gaussian import Gaussian, Moments, joint
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_matching import moment_match


def parts(moments: Moments) -> tuple[Tensor, Tensor, Tensor]:
    return moments.mean, moments.cov, moments.inv_cov_cross_cov


# --- an independent implementation ---


def textbook_moments(
    f: KernelExpansion, belief: Gaussian
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (Eqs. 14-15), covariance (Eqs. 16-18) and cov(x, f), output by output."""
    mu, Sigma, beta = belief.mean.numpy(), belief.cov.numpy(), f.weights.numpy()
    nu, E = f.inputs.numpy() - mu, f.num_outputs
    mean, cross, cov = np.zeros(E), np.zeros((len(mu), E)), np.zeros((E, E))
    for a in range(E):
        weighted = beta[a] * textbook_q(f, a, mu, Sigma)
        Lambda = np.diag(f.lengthscales[a].numpy() ** 2)
        mean[a] = weighted.sum()
        cross[:, a] = Sigma @ np.linalg.inv(Sigma + Lambda) @ nu.T @ weighted
    for a in range(E):
        for b in range(E):
            Q = textbook_Q(f, a, b, mu, Sigma)
            cov[a, b] = beta[a] @ Q @ beta[b] - mean[a] * mean[b]
            if a == b and f.gram_inverse is not None:
                cov[a, b] += f.signal_variance[a] - np.trace(f.gram_inverse[a].numpy() @ Q)
    return mean + np.asarray(f.offset), cov, cross


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_moments_are_those_of_the_textbook(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, belief = make(draws, 12, 3, 2), draws.belief(3)
    moments = moment_match(f, belief)
    mean, cov, cross_cov = textbook_moments(f, belief)
    ours = moments.mean, moments.cov, moments.cross_cov(belief)
    for part, expected in zip(ours, (mean, cov, cross_cov), strict=True):
        np.testing.assert_allclose(part, expected, rtol=0, atol=1e-10 * abs(expected).max())


# --- quadrature and noise ---


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_moments_are_those_of_quadrature(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, belief = make(draws, 10, 2, 3), draws.belief(2)
    x, w = hermite_grid(belief, order=60)
    mean_at, variance_at = f.predict(x)
    mean = w @ mean_at
    cov = (mean_at - mean).mT @ (w[:, None] * (mean_at - mean)) + torch.diag(w @ variance_at)
    cross_cov = (x - belief.mean).mT @ (w[:, None] * (mean_at - mean))

    moments = moment_match(f, belief)
    assert_close(moments.mean, mean, rtol=0, atol=1e-6)
    assert_close(moments.cov, cov, rtol=0, atol=1e-6)
    assert_close(moments.cross_cov(belief), cross_cov, rtol=0, atol=1e-6)


def test_observation_noise_adds_to_the_variances_alone(draws: Draws) -> None:
    f, belief = draws.gp(8, 2, 3), draws.belief(2)
    latent, observed = moment_match(f, belief), moment_match(f, belief, observation_noise=True)
    assert_close(observed.cov - latent.cov, torch.diag(f.noise_variance))
    assert_close(observed.mean, latent.mean)
    assert_close(observed.inv_cov_cross_cov, latent.inv_cov_cross_cov)


# --- the zero-covariance limit, on fitted models ---


def make_model(draws: Draws, batch: tuple[int, ...] = (), **choices: object) -> ExactGP:
    """An untrained GP on 15 data with 2 inputs."""
    inputs = draws.normal(15, 2)
    targets = 0.7 + inputs.sin().sum(-1) + 0.1 * draws.normal(*batch, 15)
    return exact_gp_of(inputs.expand(*batch, 15, 2), targets, **choices).double()


def train(model: ExactGP) -> ExactGP:
    model.train()
    optimizer = torch.optim.Adam(model.parameters(), lr=0.1)
    for _ in range(40):
        optimizer.zero_grad()
        prior = model(*model.train_inputs)
        (-model.likelihood(prior).log_prob(model.train_targets)).sum().backward()
        optimizer.step()
    return model.eval()


def point(x: Tensor) -> Gaussian:
    return Gaussian(x, torch.zeros(len(x), len(x), dtype=torch.float64))


@pytest.mark.parametrize("ard", [True, False], ids=["ard", "isotropic"])
@pytest.mark.parametrize("mean", [ZeroMean, ConstantMean])
@pytest.mark.parametrize("batch", [(), (1,), (3,)], ids=["single", "one", "three"])
def test_zero_covariance_recovers_the_posterior_of_a_fitted_gp(
    draws: Draws, batch: tuple, mean: type[Mean], ard: bool
) -> None:
    model = train(make_model(draws, batch, mean=mean, ard=ard))
    x = draws.normal(2).requires_grad_()
    posterior = model(x.expand(*batch, 1, 2))
    observed = model.likelihood(posterior)
    gradients = [
        torch.autograd.grad(value, x, retain_graph=True)[0] for value in posterior.mean.flatten()
    ]

    moments = moment_match(model, point(x.detach()))
    close = {"rtol": 1e-8, "atol": 1e-8}
    assert_close(moments.mean, posterior.mean.flatten(), **close)
    assert_close(moments.cov, torch.diag(posterior.variance.flatten()), **close)
    assert_close(moments.inv_cov_cross_cov, torch.stack(gradients, -1), **close)
    assert_close(
        moment_match(model, point(x.detach()), observation_noise=True).cov,
        torch.diag(observed.variance.flatten()),
        **close,
    )


def test_zero_covariance_has_finite_gradients(draws: Draws) -> None:
    f = draws.gp(8, 2, 2)
    mean = draws.normal(2).requires_grad_()
    cov = torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    sum(part.sum() for part in parts(moment_match(f, Gaussian(mean, cov)))).backward()
    assert mean.grad.isfinite().all() and cov.grad.isfinite().all()


# --- gradients ---


def test_gradient_in_the_belief(draws: Draws) -> None:
    f, belief = draws.gp(6, 3, 2), draws.belief(2, 3)

    def moments(mean: Tensor, root: Tensor) -> tuple[Tensor, ...]:
        return parts(moment_match(f, Gaussian(mean, root @ root.mT)))

    root = torch.linalg.cholesky(belief.cov)
    assert gradcheck(moments, (belief.mean.requires_grad_(), root.requires_grad_()))


@pytest.mark.parametrize("own_inputs", [False, True], ids=["shared inputs", "own inputs"])
def test_gradient_in_data_and_hyperparameters(draws: Draws, own_inputs: bool) -> None:
    f, belief = draws.gp(5, 2, 2), draws.belief(2, 2)
    inputs = draws.normal(2, 5, 2) if own_inputs else f.inputs

    def moments(inputs, targets, lengthscales, signal, noise, offset) -> tuple[Tensor, ...]:
        gp = KernelExpansion.from_data(inputs, targets, lengthscales, signal, noise, offset)
        return parts(moment_match(gp, belief, observation_noise=True))

    kernel = f.lengthscales, f.signal_variance, f.noise_variance, f.offset
    variables = inputs, draws.normal(2, 5), *kernel
    assert gradcheck(moments, tuple(variable.clone().requires_grad_() for variable in variables))


def test_gradient_in_a_network(draws: Draws) -> None:
    f, belief = draws.network(5, 2, 2), draws.belief(2, 2)

    def moments(centres: Tensor, weights: Tensor, widths: Tensor) -> tuple[Tensor, ...]:
        network = KernelExpansion(centres, weights, widths, f.signal_variance)
        return parts(moment_match(network, belief))

    variables = f.inputs, f.weights, f.lengthscales
    assert gradcheck(moments, tuple(variable.clone().requires_grad_() for variable in variables))


# --- structure ---


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_batch_is_a_loop(draws: Draws, make: Callable[..., KernelExpansion]) -> None:
    f, beliefs = make(draws, 7, 3, 2), draws.belief(2, 4, 3)
    together = parts(moment_match(f, beliefs))
    for index in np.ndindex(2, 4):
        for batched, alone in zip(together, parts(moment_match(f, beliefs[index])), strict=True):
            assert_close(batched[index], alone)


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_covariance_is_symmetric_and_positive_semidefinite(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, beliefs = make(draws, 10, 3, 3), draws.belief(20, 3, scale=1.0)
    moments = moment_match(f, beliefs)
    assert_close(moments.cov, moments.cov.mT, rtol=0, atol=0)
    both = joint(beliefs, moments.gaussian, moments.cross_cov(beliefs))
    assert torch.linalg.eigvalsh(both.cov).min() > -1e-10


def test_gradient_in_the_belief_keeps_no_array_of_pairs_of_data(draws: Draws) -> None:
    n, D, E = 60, 4, 3
    f, belief, sizes = draws.gp(n, D, E), draws.belief(D), []
    mean = belief.mean.requires_grad_()
    with saved_tensors_hooks(
        lambda tensor: (sizes.append(tensor.numel()), tensor)[1], lambda tensor: tensor
    ):
        moment_match(f, Gaussian(mean, belief.cov))
    pairs = E * (E + 1) // 2
    assert max(sizes) <= (E + 2 * pairs) * n * (D + 2) < E * n * n


# --- errors ---


FIXED = FixedNoiseGaussianLikelihood(torch.full((15,), 0.1))


@pytest.mark.parametrize(
    ("part", "other", "message"),
    [
        ("covar_module", MaternKernel(), r"or ScaleKernel\(RBFKernel\), got MaternKernel$"),
        ("covar_module", ScaleKernel(MaternKernel()), r"got ScaleKernel\(MaternKernel\)$"),
        ("covar_module", ScaleKernel(ScaleKernel(RBFKernel())), r"got ScaleKernel\(ScaleKernel\)$"),
        ("mean_module", LinearMean(2), "must be ZeroMean or ConstantMean, got LinearMean"),
        ("likelihood", FIXED, "likelihood must be GaussianLikelihood, got FixedNoise"),
    ],
)
def test_unsupported_part_of_a_model_is_an_error(
    draws: Draws, part: str, other: Module, message: str
) -> None:
    model = make_model(draws)
    setattr(model, part, other)
    with pytest.raises(TypeError, match=message):
        moment_match(model, draws.belief(2))


@pytest.mark.parametrize("batch", [(), (3,)])
def test_kernel_without_a_scale_is_one_of_scale_one(draws: Draws, batch: tuple[int, ...]) -> None:
    size, belief = torch.Size(batch), draws.belief(2)
    model = make_model(draws, batch=batch, kernel=RBFKernel(ard_num_dims=2, batch_shape=size))
    bare = parts(moment_match(model, belief))
    scaled = ScaleKernel(model.covar_module, batch_shape=size).double()
    scaled.outputscale = 1.0
    model.covar_module = scaled
    for one, other in zip(bare, parts(moment_match(model, belief)), strict=True):
        assert_close(one, other)
