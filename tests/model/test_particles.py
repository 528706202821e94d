"""Particles with common random numbers, against posterior, moment matching and linear systems."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.losses import HORIZON, SPACE, make_cost, make_kl, make_parts
from tests.model.test_rollout import assert_moments_of
from torch_pmil.control.rbf_policy import Controller, RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.kernel_expansion import KernelExpansion
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import Targets, known_part
from torch_pmil.model.particles import ParticlePrediction, sample_trajectories
from torch_pmil.model.rollout import PredictionError, predict_trajectory
from torch_pmil.search.policy_search import SearchSettings, search_policy

NAMES = ("a", "b")
PLAIN = StateSpace(NAMES, ("", ""), (), joint_match(NAMES, ("", "")))
kinds_of_targets = pytest.mark.parametrize("targets", ["difference", "successor"])


@pytest.fixture
def parts(draws: Draws) -> tuple[RBFPolicy, GPDynamics]:
    return make_parts(draws)


def make_plain(draws: Draws, targets: Targets) -> tuple[RBFPolicy, GPDynamics]:
    """In a space without angles: a policy that does nothing, and a model of smooth functions."""
    inputs = draws.normal(25, 3)
    dynamics = GPDynamics(3, 2, targets)
    outputs = torch.stack([inputs[:, 0].sin(), inputs[:, 1] - 0.5 * inputs[:, 0]], -1)
    dynamics.set_data(inputs, outputs)
    dynamics.gp.likelihood.noise = torch.full((2, 1), 0.05, dtype=torch.float64)
    return RBFPolicy(torch.zeros(1, 2), torch.ones(1), torch.ones(2)), dynamics


def knows_nothing(inputs: int) -> GPDynamics:
    """A model whose data are far away: the state changes by its prior and its noise alone."""
    dynamics = GPDynamics(inputs, 2)
    dynamics.set_data(torch.full((2, inputs), 1e3), torch.zeros(2, 2))
    return dynamics


@torch.no_grad()
@kinds_of_targets
def test_one_step_from_a_certain_state_has_the_moments_of_the_gp(
    draws: Draws, targets: Targets
) -> None:
    """With observation noise; the entries, each drawn from a GP of its own, are uncorrelated."""
    (policy, dynamics), x = make_plain(draws, targets), draws.normal(2)
    certain = Gaussian(x, torch.zeros(2, 2, dtype=torch.float64))
    mean, variance = dynamics.expansion.predict(torch.cat([x, torch.zeros(1, dtype=torch.float64)]))
    noisy = torch.diag(variance + dynamics.expansion.noise_variance)
    samples = sample_trajectories(certain, policy, dynamics, PLAIN, 1, 20_000, draws.generator)
    posterior = Gaussian(mean if targets == "successor" else x + mean, noisy)
    assert_moments_of(samples[:, 0], posterior)


@torch.no_grad()
@kinds_of_targets
def test_one_step_from_an_uncertain_state_has_the_moments_that_are_matched(
    draws: Draws, targets: Targets
) -> None:
    """Exact here, where features and action are Gaussian: all within four standard errors."""
    (policy, dynamics), state = make_plain(draws, targets), draws.belief(2)
    samples = sample_trajectories(state, policy, dynamics, PLAIN, 1, 100_000, draws.generator)
    assert_moments_of(samples[:, 0], predict_trajectory(state, policy, dynamics, PLAIN, 1)[0])


@torch.no_grad()
def test_prediction_is_the_gaussian_of_the_particles(
    draws: Draws, parts: tuple[RBFPolicy, GPDynamics]
) -> None:
    state = draws.belief(2, scale=0.02)
    predicted = ParticlePrediction(50, seed=3)(state, *parts, SPACE, 4)
    particles = sample_trajectories(state, *parts, SPACE, 4, 50, torch.Generator().manual_seed(3))
    for t in range(4):
        assert_close(predicted.mean[t], particles[:, t].mean(0))
        assert_close(predicted.cov[t], torch.cov(particles[:, t].mT))
    assert torch.equal(predicted.cov, predicted.cov.mT)


@torch.no_grad()
def test_error_of_the_mean_falls_with_the_root_of_the_number_of_particles(draws: Draws) -> None:
    """In a random walk from a certain start: root mean square over seeds, within a fifth."""
    dynamics, policy = knows_nothing(3), RBFPolicy(torch.zeros(1, 2), torch.ones(1), torch.ones(2))
    certain = Gaussian(draws.normal(2), torch.zeros(2, 2, dtype=torch.float64))
    std = (4 * (dynamics.expansion.signal_variance + dynamics.expansion.noise_variance)).sqrt()
    for count in (10, 160):
        predicted = [
            ParticlePrediction(count, seed)(certain, policy, dynamics, PLAIN, 4)[-1].mean
            for seed in range(200)
        ]
        errors = (torch.stack(predicted) - certain.mean) / std
        assert errors.square().mean().sqrt().item() == pytest.approx(1 / math.sqrt(count), rel=0.2)


def test_linear_system_moves_the_gaussian_of_the_particles_linearly(draws: Draws) -> None:
    """Mean and covariance go through the system, and grow by its noise, within four errors."""
    # shrinks every vector, so that errors do not grow
    A = torch.tensor([[0.9, 0.2], [-0.3, 0.8]], dtype=torch.float64)
    grid = torch.cartesian_prod(*[torch.linspace(-2, 2, 9, dtype=torch.float64)] * 2)
    inputs = torch.cat([grid, torch.zeros(81, 1)], -1)
    dynamics = GPDynamics(3, 2, "successor")
    dynamics.set_data(inputs, grid @ A.mT)
    one = torch.ones(2, 1, dtype=torch.float64)
    dynamics.gp.covar_module.base_kernel.lengthscale = 8 * one[..., None].expand(2, 1, 3)
    dynamics.gp.covar_module.outputscale = 100 * one[:, 0]
    dynamics.gp.likelihood.noise = 1e-4 * one  # the condition number is below 1e8
    with torch.no_grad():
        mean, variance = dynamics.expansion.predict(inputs)
    bias, noise = (mean - grid @ A.mT).abs().max(), variance + dynamics.expansion.noise_variance
    policy = RBFPolicy(torch.zeros(1, 2), torch.ones(1), torch.ones(2))
    state, count = draws.belief(2, scale=0.02), 3000
    predicted = ParticlePrediction(count)(state, policy, dynamics, PLAIN, 5).detach()
    first = state.sample(count, torch.Generator().manual_seed(0))
    belief = Gaussian(first.mean(0), torch.cov(first.mT))
    spread, std = first.std(0).max(), noise.max().sqrt()
    for t in range(1, 6):
        belief = belief.affine(A).add_noise(noise.mean(0))
        errors = 4 * math.sqrt(t / count) * std
        of_cov = 2 * spread * (errors + t * bias) + 2 * std * errors
        assert (predicted.mean[t - 1] - belief.mean).abs().max() <= errors + t * bias
        assert (predicted.cov[t - 1] - belief.cov).abs().max() <= of_cov


def test_all_predictions_use_the_same_random_numbers(
    draws: Draws, parts: tuple[RBFPolicy, GPDynamics]
) -> None:
    state, predict = draws.belief(2, scale=0.02), ParticlePrediction(20, seed=1)
    one, again, other = (
        prediction(state, *parts, SPACE, 5).mean
        for prediction in (predict, predict, ParticlePrediction(20, seed=2))
    )
    assert torch.equal(one, again)
    assert not torch.isclose(one, other).any()


def test_longer_horizon_begins_with_the_shorter_one(
    draws: Draws, parts: tuple[RBFPolicy, GPDynamics]
) -> None:
    """So that the terms of a growing horizon do not change under it."""
    state, predict = draws.belief(2, scale=0.02), ParticlePrediction(7)
    short, long = (predict(state, *parts, SPACE, horizon) for horizon in (3, 6))
    assert torch.equal(short.mean, long.mean[:3]) and torch.equal(short.cov, long.cov[:3])


def test_starts_of_a_batch_are_predicted_each_from_its_own_belief(
    draws: Draws, parts: tuple[RBFPolicy, GPDynamics]
) -> None:
    wide = draws.belief(2, 3, 2, scale=0.02)
    narrow = Gaussian(wide.mean, 1e-12 * wide.cov)
    with torch.no_grad():
        predicted, matched = (
            predict(narrow, *parts, SPACE, 1)
            for predict in (ParticlePrediction(20_000), predict_trajectory)
        )
    assert predicted.mean.shape == (2, 3, 1, 2)
    error = (predicted.mean - matched.mean).abs() / (matched.std / 20_000**0.5)
    assert error.max() < 4


@kinds_of_targets
def test_gradient_in_the_policy(draws: Draws, targets: Targets) -> None:
    policy, dynamics = make_parts(draws)
    dynamics.targets = known_part(targets, 2)
    state, predict = draws.belief(2, scale=0.02), ParticlePrediction(6)

    def last_state(centres: Tensor, weights: Tensor, log_widths: Tensor) -> tuple[Tensor, Tensor]:
        one = torch.ones(1, dtype=torch.float64)
        network = KernelExpansion(centres, weights, log_widths.exp(), one)
        controller = Controller(network, policy.u_max, policy.u_middle)
        predicted = predict(state, SimpleNamespace(controller=controller), dynamics, SPACE, 3)
        return predicted.mean[-1], predicted.cov[-1]

    variables = draws.normal(4, 3), draws.normal(1, 4), 0.3 * draws.normal(1, 3)
    assert gradcheck(last_state, tuple(variable.requires_grad_() for variable in variables))


@pytest.mark.parametrize("make_loss", [make_kl, make_cost])
def test_losses_are_computed_from_the_particles_and_by_default_from_matched_moments(
    draws: Draws, make_loss: Callable
) -> None:
    state, particles = draws.belief(2, scale=0.02), ParticlePrediction(100)
    for loss, prediction in (
        (make_loss(0, prediction=particles), particles),
        (make_loss(0), predict_trajectory),
    ):
        states = prediction(state, loss.actor_network, loss.dynamics, SPACE, HORIZON)
        expected = loss._costs(loss._observe(states))
        assert_close(loss.per_step(state), expected, rtol=1e-10, atol=0)


def test_search_on_particles_lowers_the_loss_and_repeats_itself(draws: Draws) -> None:
    state = draws.belief(2, scale=0.02)
    settings = SearchSettings(3, 3, 3, first_horizon=0.4, horizon_step=0.4)
    before = make_kl(0, prediction=ParticlePrediction(20)).per_step(state).sum().item()
    one, other = (
        search_policy(make_kl(0, prediction=ParticlePrediction(20)), state, settings)
        for _ in range(2)
    )
    assert one.loss < before
    assert torch.equal(one.per_step, other.per_step)


def test_particles_that_are_not_finite_are_named(
    draws: Draws, parts: tuple[RBFPolicy, GPDynamics], monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, dynamics = parts
    far = replace(dynamics.expansion, offset=torch.full((2,), torch.inf, dtype=torch.float64))
    monkeypatch.setattr(dynamics, "_expansion", far)
    message = "prediction of step 1 of 3 failed: q is not finite"
    with pytest.raises(PredictionError, match=message) as error:
        ParticlePrediction(5)(draws.belief(2), policy, dynamics, SPACE, 3)
    assert error.value.step == 1
