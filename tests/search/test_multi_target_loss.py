"""One policy for many targets (Eq. 31): inputs without variance, predicted in one batch."""

from __future__ import annotations

import re

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.losses import (
    HORIZON,
    NOISE_STD,
    SPACE,
    assert_gradient_is_the_difference_quotient,
    make_parts,
    start,
)
from torch_pmil.control.rbf_policy import PolicyAtTargets, RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.particles import ParticlePrediction
from torch_pmil.model.rollout import PredictionError
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.multi_target_loss import MultiTargetKLLoss
from torch_pmil.search.policy_search import SearchSettings, refit_policy, search_policy

TARGETS = torch.tensor([[0.0, 0.5], [1.0, -0.5], [-1.0, 0.3]], dtype=torch.float64)
S, K = TARGETS.shape


@pytest.fixture
def initial(draws: Draws) -> Gaussian:
    return draws.belief(2, scale=0.02)


def make_policy(draws: Draws, centres: int = 6) -> RBFPolicy:
    policy = RBFPolicy(draws.normal(centres, 3 + K), torch.tensor([2.0]), torch.ones(3 + K))
    policy.weights.data.copy_(0.7 * draws.normal(centres, 1))
    policy.log_widths.data.copy_(0.2 * draws.normal(1, 3 + K))
    return policy


def make_loss(seed: int, centres: int = 6, **kwargs) -> MultiTargetKLLoss:
    draws = Draws(seed)
    policy, dynamics = make_policy(draws, centres), make_parts(draws)[1]
    demonstrated = draws.belief(S, HORIZON, 2, scale=0.05)
    return MultiTargetKLLoss(policy, dynamics, SPACE, demonstrated, TARGETS, NOISE_STD, **kwargs)


def of_one_target(loss: MultiTargetKLLoss, i: int) -> TrajectoryKLLoss:
    """The loss of one target with an ordinary policy that acts as the joint one does there."""
    joint, known = loss.actor_network, TARGETS[i]
    policy = RBFPolicy(joint.centres[:, :3].detach(), joint.u_max, torch.ones(3))
    distance = (known - joint.centres[:, 3:]) / joint.log_widths[0, 3:].exp()
    policy.weights.data.copy_(joint.weights * torch.exp(-distance.square().sum(-1) / 2)[:, None])
    policy.log_widths.data.copy_(joint.log_widths[:, :3])
    demonstrated = Gaussian(loss.demonstrated_mean[i], loss.demonstrated_cov[i])
    return TrajectoryKLLoss(policy, loss.dynamics, SPACE, demonstrated, NOISE_STD)


def test_known_inputs_are_inputs_of_these_values_without_variance(draws: Draws) -> None:
    f, belief = draws.network(9, 5, 2), draws.belief(S, 3)
    of_x, mean = f.at_known(TARGETS), torch.cat([belief.mean, TARGETS], -1)
    assert_close(of_x.mean(belief.mean), f.mean(mean))
    cov = torch.zeros(S, 5, 5, dtype=torch.float64)
    cov[:, :3, :3] = belief.cov
    whole, seen = moment_match(f, Gaussian(mean, cov)), moment_match(of_x, belief)
    expected = whole.mean, whole.cov, whole.inv_cov_cross_cov[:, :3]
    assert_close((seen.mean, seen.cov, seen.inv_cov_cross_cov), expected)


def test_gradient_of_moments_with_weights_of_each_belief(draws: Draws) -> None:
    f, belief = draws.network(4, 4, 2), draws.belief(2, 2)

    def moments(inputs: Tensor, weights: Tensor, lengthscales: Tensor) -> tuple[Tensor, ...]:
        of_x = type(f)(inputs, weights, lengthscales, f.signal_variance).at_known(TARGETS[:2])
        found = moment_match(of_x, belief)
        return found.mean, found.cov, found.inv_cov_cross_cov

    leaves = (each.clone().requires_grad_() for each in (f.inputs, f.weights, f.lengthscales))
    assert torch.autograd.gradcheck(moments, tuple(leaves))


def test_loss_is_the_mean_of_the_losses_of_the_targets(initial: Gaussian) -> None:
    loss = make_loss(1)
    singles = [of_one_target(loss, i) for i in range(S)]
    single = torch.stack([one.per_step(initial) for one in singles])
    assert_close(loss.per_step(initial), single.mean(0))
    assert_close(loss.step_loss_for_trust(initial), single.amax(0) / SPACE.match_space.dim)
    assert_close(loss(start(initial))["loss_kl"], single.sum(-1).mean())
    means = torch.stack([one.mean_per_step(initial) for one in singles])
    assert_close(loss.mean_per_step(initial), means.mean(0))
    predicted = loss.predict(initial)
    for i, one in enumerate(singles):
        its = one.predict(initial)
        assert_close((predicted.mean[i], predicted.cov[i]), (its.mean, its.cov))


@pytest.mark.parametrize("form", ["per_step", "mean_per_step"])
@pytest.mark.parametrize("name", ["centres", "weights", "log_widths"])
def test_gradient_is_the_difference_quotient(initial: Gaussian, form: str, name: str) -> None:
    loss = make_loss(2)
    parameter = loss.actor_network.get_parameter(name)
    direction = Draws(3).normal(*parameter.shape)
    assert_gradient_is_the_difference_quotient(getattr(loss, form), initial, parameter, direction)


def test_batch_of_starts_is_a_loop(draws: Draws) -> None:
    loss, starts = make_loss(1), draws.belief(2, 2, 2, scale=0.02)
    batch = loss.per_step(starts)
    assert batch.shape == (2, 2, HORIZON)
    for index in ((0, 0), (0, 1), (1, 0), (1, 1)):
        assert_close(batch[index], loss.per_step(starts[index]))


def test_rollouts_of_all_targets_cost_what_the_prediction_costs(initial: Gaussian) -> None:
    loss = make_loss(1)
    predicted = loss.predict_states(initial)
    rollout = start(predicted)
    costs = loss.rollout_loss(type(rollout)({"next": rollout}, rollout.batch_size))["loss_kl"]
    assert_close(costs, loss(start(initial))["loss_kl"])


def test_samples_of_the_prediction_act_for_their_targets(initial: Gaussian) -> None:
    exact, sampled = make_loss(1), make_loss(1, prediction=ParticlePrediction(count=4000))
    mean, std = exact.predict(initial).mean, exact.predict(initial).std
    assert ((sampled.predict(initial).mean - mean).abs() < 0.1 * std).all()


def test_search_lowers_the_loss_of_all_targets_together(initial: Gaussian) -> None:
    loss = make_loss(4)
    before = loss.per_step(initial).sum().item()
    result = search_policy(loss, initial, SearchSettings(5, 10, 10, trust_threshold=1.0))
    assert result.loss < before
    assert result.loss == pytest.approx(loss.per_step(initial).sum().item())


def test_refitted_policy_acts_as_the_old_one_at_every_target(initial: Gaussian) -> None:
    loss, draws = make_loss(4, centres=80), Draws(5)
    features = SPACE.features(initial.sample(50, draws.generator))[:, None]
    settings = SearchSettings(first_horizon=0.2, trust_threshold=0.0)
    new = refit_policy(loss, initial, make_policy(draws, 80), settings, draws.generator)
    policies = (PolicyAtTargets(policy, TARGETS) for policy in (loss.actor_network, new))
    before, after = (policy.controller(features) for policy in policies)
    assert before.std(1).mean() > 0.1
    assert (after - before).abs().mean() < 0.2 * before.std()


def test_failed_prediction_of_one_target_is_an_error_that_names_its_step(initial: Gaussian) -> None:
    loss = make_loss(1)
    loss.demonstrated_cov[1, 2] *= -1
    with pytest.raises(PredictionError, match="comparison of step 3 of 4 failed"):
        loss.per_step(initial)


@pytest.mark.parametrize(
    ("demonstrated", "inputs", "message"),
    [
        ((HORIZON, 2), 5, "and demonstrated marginals of batch shape (4,)"),
        ((2, HORIZON, 2), 5, "got targets (3, 2) and demonstrated marginals of batch"),
        ((S, HORIZON, 2), 3, "must see dq, sin q, cos q and a target of 2, got one of 3"),
    ],
)
def test_shapes_that_do_not_fit_are_errors(
    draws: Draws, demonstrated: tuple[int, ...], inputs: int, message: str
) -> None:
    policy = RBFPolicy(torch.zeros(4, inputs), torch.ones(1), torch.ones(inputs))
    parts, shown = (policy, GPDynamics(4, 2), SPACE), draws.belief(*demonstrated)
    with pytest.raises(ValueError, match=re.escape(message)):
        MultiTargetKLLoss(*parts, shown, TARGETS, NOISE_STD)


def test_policy_for_a_target_is_the_policy_given_that_target(draws: Draws) -> None:
    policy, features = make_policy(draws), draws.normal(7, 3)
    for target in TARGETS:
        expected = policy(torch.cat([features, target.expand(7, -1)], -1))
        assert_close(policy.for_target(target)(features), expected)
