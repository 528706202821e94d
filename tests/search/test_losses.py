"""The objectives, against the KL and the cost of their prediction."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.testing import assert_close
from torchrl.objectives.pilco import ExponentialQuadraticCost

from tests.helpers.draws import Draws
from tests.helpers.losses import (
    HORIZON,
    NOISE_STD,
    SPACE,
    TIP,
    WIDTH,
    make_cost,
    make_kl,
    make_parts,
    start,
    start_belief,
)
from torch_pmil.control.state_space import MatchSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.rollout import predict_mean_trajectory, predict_trajectory
from torch_pmil.search.kl import gaussian_kl, trajectory_kl
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchSettings, search_policy
from torch_pmil.search.target_losses import ExpectedQuadraticCost, ExpectedSaturatingCost
from torch_pmil.search.trajectory_loss import TrajectoryLoss

WEIGHT = torch.tensor([[2.0, 0.5], [0.5, 1.0]], dtype=torch.float64)


@pytest.fixture
def loss() -> TrajectoryKLLoss:
    return make_kl(seed=0)


@pytest.fixture
def initial(draws: Draws) -> Gaussian:
    return start_belief(draws)


def expert_of(loss: TrajectoryKLLoss) -> Gaussian:
    return Gaussian(loss.demonstrated_mean, loss.demonstrated_cov)


def states_of(loss: TrajectoryLoss, initial: Gaussian) -> Gaussian:
    return predict_trajectory(initial, loss.actor_network, loss.dynamics, SPACE, HORIZON)


def mean_states_of(loss: TrajectoryLoss, initial: Gaussian) -> Tensor:
    parts = loss.actor_network, loss.dynamics
    return predict_mean_trajectory(initial.mean, *parts, SPACE, HORIZON)


def test_loss_is_the_kl_of_the_predicted_trajectory_and_its_steps_those_of_the_marginals(
    loss: TrajectoryKLLoss, initial: Gaussian
) -> None:
    expert, predicted, steps = expert_of(loss), loss.predict(initial), loss.per_step(initial)
    expected = trajectory_kl(expert, predicted)
    assert_close(loss(start(initial))["loss_kl"], expected, rtol=1e-12, atol=0)
    assert_close(steps.sum(), expected, rtol=1e-12, atol=0)
    assert_close(steps, gaussian_kl(expert, predicted), rtol=1e-12, atol=0)


def test_prediction_is_that_of_the_state_seen_in_the_match_space_with_noise(
    loss: TrajectoryKLLoss, cost: ExpectedSaturatingCost, initial: Gaussian
) -> None:
    """That of a cost holds no noise."""
    seen, predicted = TIP.moments(states_of(loss, initial)), loss.predict(initial)
    assert_close(predicted.mean, seen.mean, rtol=0, atol=0)
    noise = NOISE_STD**2 * torch.eye(2, dtype=torch.float64)
    assert_close(predicted.cov - seen.cov, noise.expand(HORIZON, 2, 2))
    seen = TIP.moments(states_of(cost, initial))
    assert_close(cost.predict(initial).cov, seen.cov, rtol=0, atol=0)


def test_noise_floors_the_predicted_variance(loss: TrajectoryKLLoss) -> None:
    """A tip lies on a circle: without the noise, its covariance is singular at a certain state."""
    certain = Gaussian(torch.zeros(2, dtype=torch.float64), torch.zeros(2, 2, dtype=torch.float64))
    assert torch.linalg.eigvalsh(loss.predict(certain).cov).min() >= NOISE_STD**2 * (1 - 1e-9)


@pytest.mark.parametrize("horizon", [1, 3, HORIZON])
def test_shorter_horizon_is_the_beginning_of_the_whole(
    loss: TrajectoryKLLoss, initial: Gaussian, horizon: int
) -> None:
    for per_step in (loss.per_step, loss.mean_per_step):
        beginning = per_step(initial)[:horizon]
        assert_close(per_step(initial, horizon), beginning, rtol=1e-12, atol=0)


def test_mean_objective_is_the_kl_of_a_prediction_as_wide_as_the_expert(
    loss: TrajectoryKLLoss, initial: Gaussian
) -> None:
    as_wide = Gaussian(TIP(mean_states_of(loss, initial)), loss.demonstrated_cov)
    assert_close(loss.mean_per_step(initial), gaussian_kl(expert_of(loss), as_wide))


def test_expert_that_is_the_prediction_costs_nothing(
    loss: TrajectoryKLLoss, initial: Gaussian
) -> None:
    predicted = loss.predict(initial).detach()
    perfect = TrajectoryKLLoss(loss.actor_network, loss.dynamics, SPACE, predicted, NOISE_STD)
    assert abs(perfect(start(initial))["loss_kl"].item()) <= 1e-9


def test_noise_of_each_entry_is_added_to_the_prediction_as_to_the_expert(draws: Draws) -> None:
    """Independent entries: the KL is the sum of theirs, each with its own noise."""
    parts, noise_std = make_parts(draws), torch.tensor([0.1, 0.3], dtype=torch.float64)
    demonstrated, start = draws.belief(HORIZON, 2, scale=0.05), draws.belief(2, scale=0.01)
    loss, same, one = (
        TrajectoryKLLoss(*parts, SPACE, demonstrated, std)
        for std in (noise_std, torch.full((2,), 0.1, dtype=torch.float64), 0.1)
    )
    predicted = TIP.moments(loss.predict_states(start))
    noisy = Gaussian(predicted.mean, predicted.cov + (noise_std**2).diag())
    assert_close(loss.per_step(start), gaussian_kl(demonstrated, noisy))
    assert torch.equal(same.per_step(start), one.per_step(start))


@pytest.fixture
def cost() -> ExpectedSaturatingCost:
    return make_cost(seed=0)


def weighted_cost(cost: ExpectedSaturatingCost, z: Tensor) -> Tensor:
    """1 - exp(-d(z)² / (2 width²)) with the weight that the loss was given."""
    again = Draws(0)
    make_parts(again)
    target, weight = TIP(again.normal(2)), again.cov(2, scale=1.0)
    assert torch.equal(cost.target, target)
    distance = torch.einsum("...i,ij,...j->...", z - target, weight, z - target)
    return 1 - torch.exp(-distance / (2 * WIDTH**2))


def test_cost_is_that_of_samples_of_the_prediction(
    cost: ExpectedSaturatingCost, initial: Gaussian, draws: Draws
) -> None:
    samples = weighted_cost(cost, cost.predict(initial).detach().sample(100_000, draws.generator))
    standard_error = samples.std(0) / len(samples) ** 0.5
    assert ((samples.mean(0) - cost.per_step(initial)).abs() < 4 * standard_error).all()


def test_mean_cost_is_that_of_the_mean_trajectory(
    cost: ExpectedSaturatingCost, initial: Gaussian
) -> None:
    expected = weighted_cost(cost, TIP(mean_states_of(cost, initial)))
    assert_close(cost.mean_per_step(initial), expected, rtol=1e-12, atol=1e-14)


def test_weight_may_turn_the_axes(draws: Draws) -> None:
    """Of three entries: the eigenvectors of two are symmetric, and could be transposed unseen."""
    rows = torch.cat([torch.tensor([[1.0, 0.0, 0.0, 0.0]]), TIP.weights])
    match = MatchSpace(("q", "x", "y"), ("rad", "m", "m"), TIP.angles, rows)
    space = replace(SPACE, match_space=match)
    weight, target, states = draws.cov(3, scale=1.0), draws.normal(3), draws.normal(5, 2)
    cost = ExpectedSaturatingCost(
        *make_parts(draws), space, target, width=2.0, horizon=5, weight=weight, reduction="none"
    )
    certain = cost.rollout_loss(states, torch.zeros(5, 2, 2, dtype=torch.float64))
    delta = space.observe(states) - target
    expected = 1 - torch.exp(-torch.einsum("ti,ij,tj->t", delta, weight, delta) / 8)
    assert_close(certain, expected, rtol=1e-12, atol=1e-15)


def test_cost_is_that_of_torchrl_up_to_its_jitter(initial: Gaussian) -> None:
    """TorchRL adds 1e-5 to the eigenvalues of I + S."""
    cost = make_cost(seed=1, weight=WEIGHT)
    predicted = cost.predict(initial)
    theirs = ExponentialQuadraticCost(cost.target, WEIGHT / WIDTH**2, reduction="none")
    read = TensorDict({"observation": {"mean": predicted.mean, "var": predicted.cov}})
    assert_close(cost.per_step(initial), theirs(read)["loss_cost"], rtol=0, atol=2e-5)


def test_weight_is_the_identity_unless_given(initial: Gaussian) -> None:
    plain, given = make_cost(seed=0, weight=None), make_cost(seed=0, weight=torch.eye(2))
    assert torch.equal(plain.per_step(initial), given.per_step(initial))


def test_entry_without_weight_is_ignored(initial: Gaussian) -> None:
    weight, target = torch.diag(torch.tensor([1.0, 0.0])), torch.tensor([0.2, 0.3])
    here = make_cost(seed=0, weight=weight, target=target).per_step(initial)
    other = make_cost(seed=0, weight=weight, target=target + torch.tensor([0.0, 5.0]))
    assert torch.equal(here, other.per_step(initial))


def test_doubt_of_a_kl_is_the_kl_of_an_entry(loss: TrajectoryKLLoss, initial: Gaussian) -> None:
    expected = loss.per_step(initial, 3) / loss.space.match_space.dim
    assert torch.equal(loss.step_loss_for_trust(initial, 3), expected)


def test_spread_is_the_variance_of_the_prediction_in_that_of_the_data(initial: Gaussian) -> None:
    """In the match space, in the mean over its entries, for a KL without the noise."""
    for loss in (make_kl(seed=0), make_cost(seed=0, width=0.01)):
        states = SPACE.states(loss.dynamics.train_inputs[:, :3])
        predicted = TIP.moments(loss.predict_states(initial, 3)).cov.diagonal(dim1=-2, dim2=-1)
        expected = (predicted / TIP(states).var(0)).mean(-1)
        assert_close(loss.spread(initial, 3), expected, rtol=1e-10, atol=0)


def test_spread_has_no_unit(initial: Gaussian) -> None:
    """It is the same for a tip that is seen in millimetres."""
    loss = make_kl(seed=0)
    same = loss.spread(initial)
    finer = replace(TIP, units=("mm", "mm"), weights=1000 * TIP.weights)
    loss.space = replace(SPACE, match_space=finer)
    assert_close(loss.spread(initial), same, rtol=1e-9, atol=0)


def test_doubt_of_a_cost_is_how_unsure_its_prediction_is(initial: Gaussian) -> None:
    """Whether the target is near or far."""
    near, far = (make_cost(seed=0, target=torch.full((2,), place)) for place in (0.0, 9.0))
    assert torch.equal(near.step_loss_for_trust(initial), near.spread(initial))
    assert torch.equal(near.spread(initial), far.spread(initial))


def test_quadratic_cost_is_that_of_samples(initial: Gaussian, draws: Draws) -> None:
    """Within five standard errors of 10^5 samples, and its gradient by gradcheck."""
    parts, target = make_parts(draws), torch.tensor([0.2, 0.3])
    cost = ExpectedQuadraticCost(*parts, SPACE, target, WIDTH, HORIZON, WEIGHT)
    with torch.no_grad():
        seen = cost.predict(initial)
        apart = seen.sample(100_000, draws.generator) - target
        squares = torch.einsum("...i,ij,...j->...", apart, WEIGHT, apart) / WIDTH**2
    errors = squares.std(0) / len(squares) ** 0.5
    assert ((cost.per_step(initial) - squares.mean(0)).abs() < 5 * errors).all()
    mean = seen.mean.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda m: cost._costs(Gaussian(m, seen.cov)), (mean,))
    certain = Gaussian(seen.mean, torch.zeros_like(seen.cov))
    assert_close(cost._costs(certain), cost._mean_costs(seen.mean))


@pytest.mark.parametrize("key", ["loss_kl", "loss_cost"])
def test_search_lowers_the_loss(key: str, initial: Gaussian) -> None:
    """Every loss of a trajectory can be searched."""
    loss = {"loss_kl": make_kl, "loss_cost": make_cost}[key](seed=0)
    before = loss(start(initial))[key].item()
    result = search_policy(loss, initial, SearchSettings(3, 3, 5))
    assert result.loss < before
    assert loss(start(initial))[key].item() == pytest.approx(result.loss, rel=1e-12)


INDEFINITE = "weight must be symmetric and positive semi-definite"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"target": torch.zeros(3)},
            "target must have shape (2,), the entries ('x', 'y'), got",
        ),
        ({"weight": torch.eye(3)}, "weight must have shape (2, 2), got (3, 3)"),
        ({"weight": -torch.eye(2)}, INDEFINITE),
        ({"weight": torch.tensor([[1.0, 1.0], [0.0, 1.0]])}, INDEFINITE),
    ],
)
def test_cost_that_makes_no_sense_is_an_error(wrong: dict, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_cost(seed=0, **wrong)


def test_expert_of_another_dimension_is_an_error(loss: TrajectoryKLLoss, draws: Draws) -> None:
    parts, shown = (loss.actor_network, loss.dynamics, SPACE), draws.belief(HORIZON, 3)
    with pytest.raises(ValueError, match=r"demonstrated must have the 2 .* \('x', 'y'\), got 3"):
        TrajectoryKLLoss(*parts, shown, NOISE_STD)


@pytest.mark.parametrize("make", [make_kl, make_cost])
@torch.no_grad()
def test_both_predictions_are_those_that_the_loss_was_given(
    initial: Gaussian, make: Callable[..., TrajectoryLoss]
) -> None:
    def halved(start: Tensor, *rest: Any) -> Tensor:
        return predict_mean_trajectory(start, *rest) / 2

    loss, other = make(0), make(0, mean_prediction=halved)
    assert_close(other.per_step(initial), loss.per_step(initial))
    expected = loss._mean_costs(SPACE.observe(mean_states_of(loss, initial) / 2))
    assert_close(other.mean_per_step(initial), expected)
