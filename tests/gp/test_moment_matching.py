"""Moments at a Gaussian input, against Eqs. 14-18 written naively, quadrature, sampling, and
GPyTorch's posterior.
"""

from __future__ import annotations

from collections.abc import Callable

import gpytorch
import numpy as np
import pytest
import torch
from gpytorch.kernels import Kernel, MaternKernel, RBFKernel, ScaleKernel
from gpytorch.likelihoods import FixedNoiseGaussianLikelihood, GaussianLikelihood, Likelihood
from gpytorch.means import ConstantMean, LinearMean, Mean, ZeroMean
from torch import Tensor
from torch.autograd import gradcheck
from torch.autograd.graph import saved_tensors_hooks

from tests.helpers.draws import Draws
from torch_pmil.gp import exponential_sums
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError, joint
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.gp.moments import Moments


def parts(moments: Moments) -> tuple[Tensor, Tensor, Tensor]:
    return moments.mean, moments.cov, moments.inv_cov_cross_cov


# --- an independent implementation ---


def textbook_moments(
    f: KernelExpansion, belief: Gaussian
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (Eqs. 14-15), covariance (Eqs. 16-18, each output with its own alpha and Lambda) and
    cov(x, f), entry by entry.
    """
    x, beta, mu, Sigma = (
        f.inputs.numpy(),
        f.weights.numpy(),
        belief.mean.numpy(),
        belief.cov.numpy(),
    )
    alpha2, offset = (
        f.signal_variance.numpy(),
        np.broadcast_to(np.asarray(f.offset), (f.num_outputs,)),
    )
    n, D, E = len(x), f.num_inputs, f.num_outputs
    Lambda = [np.diag(lengthscales**2) for lengthscales in f.lengthscales.numpy()]
    identity, inv = np.eye(D), np.linalg.inv

    def kernel(a: int, i: int) -> float:
        return alpha2[a] * np.exp(-(x[i] - mu) @ inv(Lambda[a]) @ (x[i] - mu) / 2)

    mean, cross = np.zeros(E), np.zeros((D, E))
    for a in range(E):
        for i in range(n):
            nu = x[i] - mu
            q = (
                alpha2[a]
                / np.sqrt(np.linalg.det(Sigma @ inv(Lambda[a]) + identity))
                * np.exp(-nu @ inv(Sigma + Lambda[a]) @ nu / 2)
            )
            mean[a] += beta[a, i] * q
            cross[:, a] += beta[a, i] * q * Sigma @ inv(Sigma + Lambda[a]) @ nu

    cov = np.zeros((E, E))
    for a in range(E):
        for b in range(E):
            R = Sigma @ (inv(Lambda[a]) + inv(Lambda[b])) + identity
            Q = np.zeros((n, n))
            for i in range(n):
                for j in range(n):
                    z = inv(Lambda[a]) @ (x[i] - mu) + inv(Lambda[b]) @ (x[j] - mu)
                    Q[i, j] = (
                        kernel(a, i)
                        * kernel(b, j)
                        / np.sqrt(np.linalg.det(R))
                        * np.exp(z @ inv(R) @ Sigma @ z / 2)
                    )
            cov[a, b] = beta[a] @ Q @ beta[b] - mean[a] * mean[b]
            if a == b and f.gram_inverse is not None:
                cov[a, b] += alpha2[a] - np.trace(f.gram_inverse[a].numpy() @ Q)
    return mean + offset, cov, cross


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_moments_are_those_of_the_textbook(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, belief = make(draws, 12, 3, 2), draws.belief(3)
    moments = moment_match(f, belief)
    mean, cov, cross_cov = textbook_moments(f, belief)
    np.testing.assert_allclose(moments.mean, mean, rtol=0, atol=1e-10 * abs(mean).max())
    np.testing.assert_allclose(moments.cov, cov, rtol=0, atol=1e-10 * abs(cov).max())
    np.testing.assert_allclose(
        moments.cross_cov(belief), cross_cov, rtol=0, atol=1e-10 * abs(cross_cov).max()
    )


# --- quadrature and sampling ---


def hermite_grid(belief: Gaussian, order: int = 60) -> tuple[Tensor, Tensor]:
    """Points (order^2, 2) and weights (order^2,) of Gauss-Hermite quadrature over a 2-D belief."""
    nodes, weights = (torch.as_tensor(a) for a in np.polynomial.hermite_e.hermegauss(order))
    white = torch.cartesian_prod(nodes, nodes)
    return belief.mean + white @ torch.linalg.cholesky(belief.cov).mT, torch.cartesian_prod(
        weights, weights
    ).prod(-1) / (2 * torch.pi)


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_moments_are_those_of_quadrature(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, belief = make(draws, 10, 2, 3), draws.belief(2)
    x, w = hermite_grid(belief)
    mean_at, variance_at = f.predict(x)
    mean = w @ mean_at
    cov = (mean_at - mean).mT @ (w[:, None] * (mean_at - mean)) + torch.diag(w @ variance_at)
    cross_cov = (x - belief.mean).mT @ (w[:, None] * (mean_at - mean))

    moments = moment_match(f, belief)
    torch.testing.assert_close(moments.mean, mean, rtol=0, atol=1e-6)
    torch.testing.assert_close(moments.cov, cov, rtol=0, atol=1e-6)
    torch.testing.assert_close(moments.cross_cov(belief), cross_cov, rtol=0, atol=1e-6)


def assert_within_standard_errors(samples: Tensor, expected: Tensor, errors: float = 4.0) -> None:
    """The mean of ``samples`` (N, ...) is ``expected`` up to so many standard errors."""
    standard_error = samples.std(0) / len(samples) ** 0.5
    assert ((samples.mean(0) - expected).abs() <= errors * standard_error).all()


@pytest.mark.parametrize("noise", [False, True], ids=["latent", "observed"])
def test_moments_are_those_of_samples(draws: Draws, noise: bool) -> None:
    f, belief = draws.gp(12, 3, 2), draws.belief(3)
    x = belief.sample(100_000, draws.generator)
    mean_at, variance_at = f.predict(x)
    variance_at = variance_at + f.noise_variance if noise else variance_at
    y = mean_at + variance_at.sqrt() * draws.normal(*mean_at.shape)

    moments = moment_match(f, belief, observation_noise=noise)
    dx, dy = x - belief.mean, y - moments.mean
    assert_within_standard_errors(y, moments.mean)
    assert_within_standard_errors(dy[:, :, None] * dy[:, None, :], moments.cov)
    assert_within_standard_errors(dx[:, :, None] * dy[:, None, :], moments.cross_cov(belief))


def test_observation_noise_adds_to_the_variances_alone(draws: Draws) -> None:
    f, belief = draws.gp(8, 2, 3), draws.belief(2)
    latent, observed = moment_match(f, belief), moment_match(f, belief, observation_noise=True)
    torch.testing.assert_close(observed.cov - latent.cov, torch.diag(f.noise_variance))
    torch.testing.assert_close(observed.mean, latent.mean)
    torch.testing.assert_close(observed.inv_cov_cross_cov, latent.inv_cov_cross_cov)


# --- the zero-covariance limit, on fitted models ---


class ExactGP(gpytorch.models.ExactGP):
    def __init__(
        self, inputs: Tensor, targets: Tensor, mean: Mean, kernel: Kernel, likelihood: Likelihood
    ) -> None:
        super().__init__(inputs, targets, likelihood)
        self.mean_module, self.covar_module = mean, kernel

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


def make_model(
    draws: Draws,
    batch: tuple[int, ...] = (),
    mean: type[Mean] = ZeroMean,
    ard: int | None = 2,
    kernel: Kernel | None = None,
) -> ExactGP:
    """An untrained GP on 15 data with 2 inputs."""
    size = torch.Size(batch)
    inputs = draws.normal(15, 2)
    targets = 0.7 + inputs.sin().sum(-1) + 0.1 * draws.normal(*batch, 15)
    kernel = kernel or ScaleKernel(RBFKernel(ard_num_dims=ard, batch_shape=size), batch_shape=size)
    return ExactGP(
        inputs.expand(*batch, 15, 2),
        targets,
        mean(batch_shape=size),
        kernel,
        GaussianLikelihood(batch_shape=size),
    ).double()


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


@pytest.mark.parametrize("ard", [2, None], ids=["ard", "isotropic"])
@pytest.mark.parametrize("mean", [ZeroMean, ConstantMean])
@pytest.mark.parametrize("batch", [(), (1,), (3,)], ids=["single", "one", "three"])
def test_zero_covariance_recovers_the_posterior_of_a_fitted_gp(
    draws: Draws, batch: tuple, mean: type[Mean], ard: int | None
) -> None:
    model = train(make_model(draws, batch, mean, ard))
    x = draws.normal(2).requires_grad_()
    posterior = model(x.expand(*batch, 1, 2))
    observed = model.likelihood(posterior)
    gradients = [
        torch.autograd.grad(value, x, retain_graph=True)[0] for value in posterior.mean.flatten()
    ]

    moments = moment_match(model, point(x.detach()))
    close = {"rtol": 1e-8, "atol": 1e-8}
    torch.testing.assert_close(moments.mean, posterior.mean.flatten(), **close)
    torch.testing.assert_close(moments.cov, torch.diag(posterior.variance.flatten()), **close)
    torch.testing.assert_close(moments.inv_cov_cross_cov, torch.stack(gradients, -1), **close)
    torch.testing.assert_close(
        moment_match(model, point(x.detach()), observation_noise=True).cov,
        torch.diag(observed.variance.flatten()),
        **close,
    )


def test_zero_covariance_has_finite_gradients(draws: Draws) -> None:
    f = draws.gp(8, 2, 2)
    mean, cov = (
        draws.normal(2).requires_grad_(),
        torch.zeros(2, 2, dtype=torch.float64, requires_grad=True),
    )
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

    variables = (
        inputs,
        draws.normal(2, 5),
        f.lengthscales,
        f.signal_variance,
        f.noise_variance,
        f.offset,
    )
    assert gradcheck(moments, tuple(variable.clone().requires_grad_() for variable in variables))


def test_gradient_in_a_network(draws: Draws) -> None:
    f, belief = draws.network(5, 2, 2), draws.belief(2, 2)

    def moments(centres: Tensor, weights: Tensor, widths: Tensor) -> tuple[Tensor, ...]:
        return parts(
            moment_match(KernelExpansion(centres, weights, widths, f.signal_variance), belief)
        )

    variables = f.inputs, f.weights, f.lengthscales
    assert gradcheck(moments, tuple(variable.clone().requires_grad_() for variable in variables))


# --- structure ---


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_batch_is_a_loop(draws: Draws, make: Callable[..., KernelExpansion]) -> None:
    f, beliefs = make(draws, 7, 3, 2), draws.belief(2, 4, 3)
    together = parts(moment_match(f, beliefs))
    for index in np.ndindex(2, 4):
        for batched, alone in zip(together, parts(moment_match(f, beliefs[index])), strict=True):
            torch.testing.assert_close(batched[index], alone)


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_covariance_is_symmetric_and_positive_semidefinite(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, beliefs = make(draws, 10, 3, 3), draws.belief(20, 3, scale=1.0)
    moments = moment_match(f, beliefs)
    torch.testing.assert_close(moments.cov, moments.cov.mT, rtol=0, atol=0)
    both = joint(beliefs, moments.gaussian, moments.cross_cov(beliefs))
    assert torch.linalg.eigvalsh(both.cov).min() > -1e-10


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_chunks_do_not_change_the_result(
    draws: Draws, make: Callable[..., KernelExpansion], monkeypatch: pytest.MonkeyPatch
) -> None:
    f, belief = make(draws, 9, 2, 3), draws.belief(2, 2)

    def result() -> list[Tensor]:
        mean, weights = belief.mean.clone().requires_grad_(), f.weights.clone().requires_grad_()
        g = KernelExpansion(
            f.inputs,
            weights,
            f.lengthscales,
            f.signal_variance,
            f.gram_inverse,
            f.noise_variance,
            f.offset,
        )
        moments = parts(moment_match(g, Gaussian(mean, belief.cov)))
        return [
            *moments,
            *torch.autograd.grad(sum(part.square().sum() for part in moments), (mean, weights)),
        ]

    whole = result()
    monkeypatch.setattr(exponential_sums, "CACHED_NUMBERS", 10)
    for together, chunked in zip(whole, result(), strict=True):
        torch.testing.assert_close(together, chunked)


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


def test_wrong_number_of_inputs_is_an_error(draws: Draws) -> None:
    with pytest.raises(ValueError, match="must have the model's 3 inputs, got 2"):
        moment_match(draws.gp(5, 3, 1), draws.belief(2))


@pytest.mark.parametrize(
    ("kernel", "name"),
    [
        (MaternKernel(), "MaternKernel"),
        (ScaleKernel(MaternKernel()), r"ScaleKernel\(MaternKernel\)"),
        (ScaleKernel(ScaleKernel(RBFKernel())), r"ScaleKernel\(ScaleKernel\)"),
    ],
)
def test_unsupported_kernel_is_an_error(draws: Draws, kernel: Kernel, name: str) -> None:
    with pytest.raises(TypeError, match=rf"or ScaleKernel\(RBFKernel\), got {name}$"):
        moment_match(make_model(draws, kernel=kernel), draws.belief(2))


@pytest.mark.parametrize("batch", [(), (3,)])
def test_kernel_without_a_scale_is_one_of_scale_one(draws: Draws, batch: tuple[int, ...]) -> None:
    size, belief = torch.Size(batch), draws.belief(2)
    model = make_model(draws, batch=batch, kernel=RBFKernel(ard_num_dims=2, batch_shape=size))
    bare = parts(moment_match(model, belief))
    scaled = ScaleKernel(model.covar_module, batch_shape=size).double()
    scaled.outputscale = 1.0
    model.covar_module = scaled
    for one, other in zip(bare, parts(moment_match(model, belief)), strict=True):
        torch.testing.assert_close(one, other)


def test_unsupported_mean_is_an_error(draws: Draws) -> None:
    model = make_model(draws)
    model.mean_module = LinearMean(2)
    with pytest.raises(
        TypeError, match="mean_module must be ZeroMean or ConstantMean, got LinearMean"
    ):
        moment_match(model, draws.belief(2))


def test_unsupported_likelihood_is_an_error(draws: Draws) -> None:
    model = make_model(draws)
    model.likelihood = FixedNoiseGaussianLikelihood(torch.full((15,), 0.1))
    with pytest.raises(TypeError, match="likelihood must be GaussianLikelihood, got FixedNoise"):
        moment_match(model, draws.belief(2))


@pytest.mark.parametrize(
    ("cov", "message"),
    [
        (-10.0, r"must be positive definite, got eigenvalues from"),
        (float("nan"), "must be finite, got nan"),
    ],
    ids=["negative", "nan"],
)
def test_covariance_that_is_none_is_an_error(draws: Draws, cov: float, message: str) -> None:
    with pytest.raises(NotPositiveDefiniteError, match=message):
        moment_match(
            draws.gp(5, 2, 1), Gaussian(draws.normal(2), cov * torch.eye(2, dtype=torch.float64))
        )


def test_singular_gram_matrix_is_an_error_that_names_the_output(draws: Draws) -> None:
    one, noise = torch.ones(2, dtype=torch.float64), torch.tensor([1.0, 0.0], dtype=torch.float64)
    with pytest.raises(NotPositiveDefiniteError, match=r"Gram matrix .* batch element \(1,\)"):
        KernelExpansion.from_data(
            torch.zeros(3, 1, dtype=torch.float64), draws.normal(2, 3), one[:, None], one, noise
        )


@pytest.mark.parametrize("make", [Draws.gp, Draws.network])
def test_belief_that_is_none_is_an_error(
    draws: Draws, make: Callable[..., KernelExpansion]
) -> None:
    f, belief = make(draws, 5, 2, 1), draws.belief(2)
    with pytest.raises(ValueError, match="mean of belief must be finite"):
        moment_match(f, Gaussian(belief.mean * torch.nan, belief.cov))
    with pytest.raises(NotPositiveDefiniteError, match="must be symmetric"):
        moment_match(f, Gaussian(belief.mean, belief.cov + torch.ones(2, 2).triu(1)))
    with pytest.raises(NotPositiveDefiniteError, match="must be positive definite"):
        moment_match(f, Gaussian(belief.mean, -0.1 * belief.cov))
    with pytest.raises(ValueError, match=r"of torch\.float64, got torch\.float32"):
        moment_match(f, Gaussian(belief.mean.float(), belief.cov.float()))
