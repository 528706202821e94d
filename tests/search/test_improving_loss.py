"""Imitation, then the sum of a cost and the weighted KL: of each method that a search calls."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.losses import HORIZON, NOISE_STD, SPACE, make_kl, make_parts, start, start_belief
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import in_one_vector
from torch_pmil.search.improving_loss import ImprovingKLLoss
from torch_pmil.search.losses import FAR, TrajectoryKLLoss
from torch_pmil.search.reparameterisation import ReparameterisedLoss
from torch_pmil.search.target_costs import Cost, FunctionCost, QuadraticCost, SaturatingCost
from torch_pmil.search.trajectory_loss import TrajectoryLoss

COST = SaturatingCost(target={"x": 0.1, "y": 0.4}, width=0.3)
SAMPLED = FunctionCost(lambda states, actions: states[..., 0].square() + actions[..., 0].square())
WEIGHT = 0.3
METHODS = ("per_step", "mean_per_step", "cross_entropy_per_step")
BESIDE = {"cross_entropy_per_step": "per_step"}  # the cost has no cross-entropy


def make(improving: bool, cost: Cost = COST) -> ImprovingKLLoss:
    """A loss of the policy and the model of ``make_kl(0)``."""
    kl = make_kl(0)
    demonstrated = Gaussian(kl.demonstrated_mean, kl.demonstrated_cov)
    parts = make_parts(Draws(0))
    loss = ImprovingKLLoss(*parts, SPACE, demonstrated, NOISE_STD, cost, WEIGHT)
    if improving:
        loss.improve()
    return loss


def cost_alone(cost: Cost = COST) -> TrajectoryLoss:
    return cost.loss(*make_parts(Draws(0)), SPACE, HORIZON)


@pytest.fixture
def initial() -> Gaussian:
    return start_belief(Draws(1))


def value_and_gradient(loss: TrajectoryLoss, name: str, initial: Gaussian) -> tuple[float, Tensor]:
    """As a search computes them."""
    reparameterised = ReparameterisedLoss(loss)
    function = reparameterised.as_function(getattr(loss, name), initial, HORIZON)
    return function(in_one_vector(reparameterised.variables))


@pytest.mark.parametrize("cost", [COST, SAMPLED])
def test_imitation_is_that_of_the_kl_bit_for_bit(cost: Cost, initial: Gaussian) -> None:
    loss, kl = make(False, cost), make_kl(0)
    for name in (*METHODS, "step_loss_for_trust", "predict"):
        ours, expected = getattr(loss, name)(initial), getattr(kl, name)(initial)
        pairs = [(ours, expected)]
        if isinstance(ours, Gaussian):
            pairs = [(ours.mean, expected.mean), (ours.cov, expected.cov)]
        assert all(torch.equal(*pair) for pair in pairs), name
    states = Draws(2).normal(7, HORIZON + 1, 2)
    assert torch.equal(loss.sample_costs(states), kl.sample_costs(states))
    assert torch.equal(loss(start(initial))["loss_kl"], kl(start(initial))["loss_kl"])
    assert loss.has_moments and type(loss.prediction) is type(kl.prediction)


@pytest.mark.parametrize("name", METHODS)
def test_imitation_has_the_compiled_objective_of_the_kl(name: str, initial: Gaussian) -> None:
    loss, kl = make(False), make_kl(0)
    assert (loss.objective(getattr(loss, name), initial, HORIZON) is None) == (
        kl.objective(getattr(kl, name), initial, HORIZON) is None
    )
    ours, expected = (value_and_gradient(each, name, initial) for each in (loss, kl))
    assert ours[0] == expected[0] and torch.equal(ours[1], expected[1])


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("cost", [COST, QuadraticCost(target={"y": 0.4}, width=0.3)])
def test_improvement_is_the_weighted_sum(cost: Cost, name: str, initial: Gaussian) -> None:
    """Whether kernels or the formulas compute it; they do not know the quadratic cost."""
    loss, kl, alone = make(True, cost), make_kl(0), cost_alone(cost)
    beside = BESIDE.get(name, name)
    of_kl = getattr(kl, name)(initial, 3)
    assert_close(
        getattr(loss, name)(initial, 3), getattr(alone, beside)(initial, 3) + WEIGHT * of_kl
    )
    whole = value_and_gradient(loss, name, initial)
    first, second = (
        value_and_gradient(alone, beside, initial),
        value_and_gradient(kl, name, initial),
    )
    assert whole[0] == pytest.approx(first[0] + WEIGHT * second[0])
    assert_close(whole[1], first[1] + WEIGHT * second[1])


def test_kernels_compute_the_improvement_where_they_compute_both_parts(initial: Gaussian) -> None:
    loss = make(True)
    for name in METHODS:
        alone = loss.cost.objective(getattr(loss.cost, BESIDE.get(name, name)), initial, HORIZON)
        ours = loss.objective(getattr(loss, name), initial, HORIZON)
        assert (ours is None) == (alone is None)
    assert loss.objective(lambda initial, horizon: initial.mean, initial, HORIZON) is None


def test_samples_cost_the_sum_in_nats_near_the_demonstrations() -> None:
    loss, kl, alone = make(True), make_kl(0), cost_alone()
    states, M = Draws(2).normal(7, HORIZON + 1, 2), SPACE.match_space.dim
    nats = FAR * M / 2 * kl.sample_costs(states)
    assert_close(loss.sample_costs(states), alone.sample_costs(states) + WEIGHT * nats)
    half_square = (FAR * M / 2) * torch.expm1(kl.sample_costs(states))
    near = half_square < 0.5
    assert_close(nats[near], half_square[near], rtol=0.02, atol=0)


def test_improvement_trusts_what_is_sure(initial: Gaussian) -> None:
    loss = make(True)
    assert torch.equal(loss.step_loss_for_trust(initial), loss.spread(initial))


def test_penalty_has_no_weight(initial: Gaussian) -> None:
    loss = make(True)
    plain = loss.per_step(initial)
    with loss.penalised(lambda states: 2 + 0 * states.mean[..., 0]):
        assert_close(loss.per_step(initial), plain + 2)
        assert loss.objective(loss.per_step, initial, HORIZON) is None
    assert_close(loss.per_step(initial), plain)


def test_loss_of_predicted_beliefs_is_that_of_the_call(initial: Gaussian) -> None:
    loss = make(True)
    states = loss.predict_states(initial)
    belief = {"mean": states.mean, "var": states.cov}
    predicted = TensorDict({"next": {"observation": belief}}, [HORIZON])
    assert_close(loss.rollout_loss(predicted)["loss_kl"], loss(start(initial))["loss_kl"])


def test_sampled_cost_is_added_and_has_no_moments(initial: Gaussian) -> None:
    loss, kl, alone = make(True, SAMPLED), make_kl(0), cost_alone(SAMPLED)
    assert not loss.has_moments
    assert_close(loss.per_step(initial), alone.per_step(initial) + WEIGHT * kl.per_step(initial))


@pytest.mark.parametrize("change", [copy.deepcopy, lambda loss: loss.double()])
def test_policy_and_model_are_registered_once(
    change: Callable[[ImprovingKLLoss], ImprovingKLLoss], initial: Gaussian
) -> None:
    loss = change(make(True))
    assert loss.state_dict().keys() == make_kl(0).state_dict().keys() | {"improving"}
    assert len(list(loss.parameters())) == len(list(loss.actor_network.parameters()))
    before = loss.cost.per_step(initial)
    assert loss.cost.actor_network is loss.actor_network and loss.improving
    assert isinstance(loss.actor_network, RBFPolicy)
    loss.actor_network.weights.data.mul_(2.0)
    assert not torch.equal(loss.cost.per_step(initial), before)


def test_cost_moves_with_the_loss() -> None:
    loss = make(True).float()
    tensors = [*loss.state_dict().values(), *loss.cost.state_dict().values()]
    assert not any(each.dtype == torch.float64 for each in tensors)


def test_state_holds_the_phase() -> None:
    loss, other = make(True), make(False)
    other.load_state_dict(loss.state_dict())
    assert other.improving
    other.improve(False)
    assert not other.improving and isinstance(other, TrajectoryKLLoss)


@pytest.mark.parametrize("weight", [0.0, -1.0, math.nan, math.inf])
def test_weight_is_positive(weight: float) -> None:
    kl = make_kl(0)
    demonstrated = Gaussian(kl.demonstrated_mean, kl.demonstrated_cov)
    parts = make_parts(Draws(0))
    with pytest.raises(ValueError, match=r"^imitation_weight must be a positive finite number"):
        ImprovingKLLoss(*parts, SPACE, demonstrated, NOISE_STD, COST, weight)
