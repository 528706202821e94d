"""Admission to the robot: refusals, searches with a penalty, and the steps that are left."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.integrator import SPACE, U_MAX, belief_at_one, integrator_loss, random_policy
from torch_pmil.control.module_policy import ModulePolicy
from torch_pmil.control.state_box import StateBox
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.rollout import PredictionError
from torch_pmil.model.sampled_rollouts import SampledPrediction
from torch_pmil.search.admission import admit
from torch_pmil.search.policy_search import SearchResult, SearchSettings, search_policy
from torch_pmil.search.sampled_cost import ExpectedSampledCost
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.search.trial_search import TrialSearch

HORIZON, SETTINGS = 4, SearchSettings(10, 20, 40, first_horizon=1.0)

INITIAL = belief_at_one(1e-4)
Searched = tuple[TrajectoryLoss, SearchResult]


@pytest.fixture
def searched() -> Searched:
    """A policy that comes down from 1 m to 0.4 m, as was demonstrated."""
    mean = torch.tensor([0.85, 0.7, 0.55, 0.4], dtype=torch.float64)
    loss = integrator_loss(random_policy(Draws(seed=1)), mean, 0.01)
    return loss, search_policy(loss, INITIAL, SETTINGS)


def box(low: float) -> StateBox:
    return StateBox(SPACE, {"x": (low, 50.0)}, 0.05)


def assert_same(loss: TrajectoryLoss, parameters: dict[str, torch.Tensor]) -> None:
    for name, value in loss.actor_network.state_dict().items():
        assert torch.equal(value, parameters[name])


def test_policy_that_stays_is_admitted_as_it_is(searched: Searched) -> None:
    loss, result = searched
    before = copy.deepcopy(loss.actor_network.state_dict())
    admission = admit(loss, INITIAL, box(-50.0), SETTINGS, result)
    assert admission.result is result
    assert (admission.refused, admission.steps) == (0, HORIZON)
    assert 0 <= admission.leaving_probability < 1e-12
    assert_same(loss, before)


def test_refused_policy_is_searched_on_until_it_stays(searched: Searched) -> None:
    """The loss grows; the result holds it without the penalty."""
    loss, result = searched
    tight = box(0.5)
    admission = admit(loss, INITIAL, tight, SETTINGS, result)
    assert 1 <= admission.refused <= 3
    assert admission.steps == HORIZON
    assert admission.leaving_probability <= tight.threshold
    with torch.no_grad():
        states = loss.predict_states(INITIAL)
        assert tight.leaving_by_step(states).sum().item() == admission.leaving_probability
        assert loss.per_step(INITIAL).sum().item() == pytest.approx(admission.result.loss)
    assert admission.result.loss > result.loss
    assert admission.result.evaluations > result.evaluations


def test_first_steps_are_left_of_a_policy_that_leaves_whatever_the_penalty(
    searched: Searched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as keep the accumulated probability below the threshold."""
    loss, result = searched
    leaving = torch.tensor([0.01, 0.02, 0.03, 0.5], dtype=torch.float64)
    monkeypatch.setattr(StateBox, "leaving_by_step", lambda box, states: leaving)
    monkeypatch.setattr("torch_pmil.search.admission.search_policy", lambda *_, **__: result)
    admission = admit(loss, INITIAL, box(0.5), SETTINGS, result)
    assert (admission.refused, admission.steps) == (3, 2)
    assert admission.leaving_probability == pytest.approx(0.56)


def test_first_steps_are_left_of_a_module_that_leaves() -> None:
    """No search lowers its moments; the policy stays as it is."""
    mean = torch.tensor([0.85, 0.7, 0.55, 0.4], dtype=torch.float64)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        policy = ModulePolicy(torch.nn.Linear(1, 1), torch.ones(1), U_MAX, torch.zeros(1))
    loss, settings = integrator_loss(policy, mean, 0.01), replace(SETTINGS, sample_steps=3)
    search = TrialSearch(settings, lambda: policy, torch.Generator().manual_seed(0))
    result = search.run(loss, INITIAL, None)
    before = copy.deepcopy(policy.state_dict())
    admission = admit(loss, INITIAL, box(5.0), SETTINGS, result)
    assert (admission.refused, admission.steps, admission.result) == (1, 0, result)
    assert_same(loss, before)


@pytest.mark.parametrize(("low", "refused"), [(5.0, 3), (1e9, 1)])
def test_no_step_is_left_where_even_the_first_one_leaves(
    searched: Searched, low: float, refused: int
) -> None:
    """The policy stays what it is where no penalty is finite."""
    loss, result = searched
    before = copy.deepcopy(loss.actor_network.state_dict())
    admission = admit(loss, INITIAL, StateBox(SPACE, {"x": (low, 2 * low + 50)}), SETTINGS, result)
    assert (admission.refused, admission.steps) == (refused, 0)
    assert admission.leaving_probability == 1.0
    if low == 1e9:
        assert_same(loss, before)


def test_steps_that_cannot_be_predicted_leave(
    searched: Searched, monkeypatch: pytest.MonkeyPatch
) -> None:
    loss, result = searched
    monkeypatch.setattr("torch_pmil.search.admission.search_policy", lambda *_, **__: result)
    predict = loss.predict_states

    def failing(initial: Gaussian, horizon: int | None = None) -> Gaussian:
        if horizon is None or horizon > 2:
            raise PredictionError("prediction of step 3 failed", 3)
        return predict(initial, horizon)

    monkeypatch.setattr(loss, "predict_states", failing)
    admission = admit(loss, INITIAL, box(-50.0), SETTINGS, result)
    assert (admission.steps, admission.leaving_probability) == (2, 1.0)


def test_policy_of_a_cost_function_is_refused_and_not_searched_on(searched: Searched) -> None:
    """A penalty needs moments; what is left is a motion up to where the box may be left."""
    kl, result = searched
    parts = kl.actor_network, kl.dynamics, kl.space

    def cost(states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        return states[..., 0] ** 2 + 0 * actions[..., 0]

    loss = ExpectedSampledCost(*parts, cost, HORIZON, prediction=SampledPrediction(50))
    admission = admit(loss, INITIAL, box(0.5), SETTINGS, result)
    assert admission.refused == 1 and admission.result is result
    assert 0 < admission.steps < HORIZON
