"""The search on sampled trajectories: its costs, its steps, and which policy a trial keeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest
import torch
from torch.testing import assert_close

from tests.helpers.draws import Draws
from tests.helpers.integrator import (
    belief_at_one,
    damped_integrator,
    integrator_loss,
    random_policy,
)
from tests.helpers.losses import make_cost, make_kl
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search import sample_search, trial_search
from torch_pmil.search.losses import FAR, TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchResult, SearchSettings
from torch_pmil.search.promise import SAMPLES, PredictedSuccess
from torch_pmil.search.sample_search import expected_cost, search_on_samples
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.search.trial_search import TrialSearch

HORIZON = 6
INITIAL = belief_at_one(0.04)
SHOWN = 0.75 ** torch.arange(1.0, HORIZON + 1, dtype=torch.float64)


def integrator() -> TrajectoryKLLoss:
    return integrator_loss(random_policy(Draws(0)), SHOWN, 0.05**2)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_cost_of_a_sample_is_the_logarithm_of_its_distance(draws: Draws) -> None:
    loss = make_kl(0)
    states = draws.normal(5, loss.horizon + 1, 2)
    offset = loss.space.observe(states[:, 1:]) - loss.demonstrated_mean
    square = torch.einsum(
        "nti,tij,ntj->nt", offset, torch.linalg.inv(loss.demonstrated_cov), offset
    )
    assert_close(loss.sample_costs(states), (1 + square / (2 * FAR)).log())


def test_cost_of_a_sample_away_from_a_target_is_logarithmic(draws: Draws) -> None:
    loss = make_cost(0)
    states = draws.normal(5, loss.horizon + 1, 2)
    residual = (loss.space.observe(states[:, 1:]) - loss.target) @ loss.to_widths.mT
    assert_close(loss.sample_costs(states), (1 + residual.square().sum(-1) / 2).log())


def test_a_state_may_change_the_cost_of_a_whole_motion_but_only_a_step_of_an_imitation(
    draws: Draws,
) -> None:
    cost, imitation = make_cost(0), make_kl(0)
    states = draws.normal(5, cost.horizon + 1, 2)
    of_motions = cost.sample_costs(states).sum(-1)
    assert_close(cost.typical_cost(states), of_motions.mean())
    assert imitation.typical_cost(states).item() == 1


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_cost_is_searched_on_samples_alone_where_the_start_is_not_sure(
    monkeypatch: pytest.MonkeyPatch, draws: Draws, scale: float
) -> None:
    """Sure is what is trusted of a step: here a tenth of the variance of the data."""
    loss, found, alone = make_cost(0), TrialSearch._on_samples_alone, list[int]()

    def noted(search: TrialSearch, *given: Any) -> SearchResult:
        alone.append(1)
        return found(search, *given)

    monkeypatch.setattr(TrialSearch, "_on_samples_alone", noted)
    settings = SearchSettings(1, 1, 1, trust_threshold=0.1)
    start = Gaussian(draws.normal(2), scale * draws.cov(2, scale=1.0))
    spread = loss._spread_of(start).item()
    search = TrialSearch(settings, lambda: make_cost(0).actor_network, generator())
    search.run(loss, start, None)
    assert len(alone) == (spread > 0.1) == (scale == 1.0)


def test_search_brings_the_samples_near_what_was_demonstrated() -> None:
    """The policy then matches it by exact moments too, and the same seed finds the same policy."""
    found = []
    for _ in range(2):
        loss = integrator()
        before, kl = expected_cost(loss, INITIAL, 1), loss.per_step(INITIAL).sum().item()
        result = search_on_samples(loss, INITIAL, 150, generator())
        assert result.evaluations == 150 and result.loss < result.initial_loss
        assert expected_cost(loss, INITIAL, 1) < 0.2 * before
        assert loss.per_step(INITIAL).sum().item() < 0.5 * kl
        assert all(parameter.grad is None for parameter in loss.actor_network.parameters())
        found.append(loss.actor_network.weights.detach())
    assert torch.equal(*found)


def test_frozen_parameters_stay_and_unused_ones_do_no_harm() -> None:
    loss = integrator()
    policy = loss.actor_network
    policy.centres.requires_grad_(False)
    policy.register_parameter("unused", torch.nn.Parameter(torch.ones(2).double()))
    before = [policy.centres.clone(), policy.weights.clone()]
    search_on_samples(loss, INITIAL, 5, generator())
    assert torch.equal(policy.centres, before[0]) and not torch.equal(policy.weights, before[1])
    assert policy.unused.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("seed", range(3))
def test_expected_cost_is_that_of_the_predicted_marginals(seed: int) -> None:
    """Of a nearly linear system that is well known: by Monte Carlo on exact moments."""
    loss = integrator()
    loss.actor_network.weights.data.copy_(0.3 * Draws(seed).normal(8, 1))
    with torch.no_grad():
        states = loss.predict_states(INITIAL).sample(20_000, generator())
        whole = torch.cat([torch.zeros_like(states[:, :1]), states], 1)
        costs = loss.sample_costs(whole).sum(-1)
    judged = [expected_cost(loss, INITIAL, judge) for judge in range(20)]
    assert sum(judged) / len(judged) == pytest.approx(costs.mean().item(), rel=0.05)


def test_search_ends_before_a_step_that_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    loss, steps = integrator(), iter([1.0, 1.0, math.nan])
    costs = loss.sample_costs
    monkeypatch.setattr(loss, "sample_costs", lambda states: next(steps) * costs(states))
    result = search_on_samples(loss, INITIAL, 5, generator())
    assert (result.iterations, result.failures, result.stop_reason) == (2, 1, "numerical failure")
    assert all(parameter.isfinite().all() for parameter in loss.actor_network.parameters())


class Scripted:
    """A promise for which these success rates are predicted, the last of them for ever."""

    def __init__(self, *rates: float) -> None:
        self.aim, self.left = 0.975, list(rates)

    def predicted(self, *_: object) -> PredictedSuccess:
        rate = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        return PredictedSuccess(round(rate * SAMPLES))


def leave_weights(
    patch: pytest.MonkeyPatch,
    loss: TrajectoryLoss,
    numbers: Sequence[int],
    module: object = sample_search,
    name: str = "search_on_samples",
) -> None:
    """Let the searches of a kind end with these weights, one number after the other."""
    search, left = getattr(module, name), iter(numbers)

    def marked(*arguments: object, **options: object) -> object:
        result = search(*arguments, **options)
        loss.actor_network.weights.data.fill_(next(left))
        return result

    patch.setattr(module, name, marked)


@pytest.mark.parametrize(
    ("promised", "costs", "kept"),
    [(1.0, (1.0, 2.0), 2), (0.5, (1.0, 2.0), 1), (0.5, (2.0, 1.0), 2), (None, (1.0, 2.0), 1)],
    ids=["promise kept", "samples are better", "the loss is better", "no promise"],
)
def test_trial_keeps_what_keeps_the_promise_or_costs_less(
    monkeypatch: pytest.MonkeyPatch,
    promised: float | None,
    costs: tuple[float, float],
    kept: int,
) -> None:
    loss, left = integrator(), iter(costs)
    leave_weights(monkeypatch, loss, [1])
    leave_weights(monkeypatch, loss, [2], trial_search, "search_policy")
    monkeypatch.setattr(trial_search, "expected_cost", lambda *_: next(left))
    promise = None if promised is None else Scripted(promised)
    settings = SearchSettings(2, 2, 2, sample_steps=3)
    search = TrialSearch(settings, lambda: random_policy(Draws(0)), generator(), promise)
    result = search.run(loss, INITIAL, None)
    assert loss.actor_network.weights[0, 0].item() == kept
    assert result.evaluations > 3  # the work of both
    assert not search.refitted


@pytest.mark.parametrize(("promised", "searched"), [(0.49, 0), (0.5, 1), (None, 1)])
def test_trial_searches_the_loss_only_where_samples_succeed_from_half_the_starts(
    monkeypatch: pytest.MonkeyPatch, promised: float | None, searched: int
) -> None:
    loss, found, searches = integrator(), trial_search.search_policy, list[int]()

    def counted(*arguments: object, **options: object) -> object:
        searches.append(1)
        return found(*arguments, **options)

    monkeypatch.setattr(trial_search, "search_policy", counted)
    promise = None if promised is None else Scripted(promised)
    settings = SearchSettings(2, 2, 2, sample_steps=3)
    search = TrialSearch(settings, lambda: random_policy(Draws(0)), generator(), promise)
    result = search.run(loss, INITIAL, None)
    assert len(searches) == searched and search.result is result
    assert (result.evaluations == 3) is not bool(searched)


@pytest.mark.parametrize(("predicted", "anew"), [(0.09, True), (0.1, False), (None, False)])
def test_trial_begins_with_a_random_policy_while_the_last_one_is_predicted_to_fail(
    monkeypatch: pytest.MonkeyPatch, predicted: float | None, anew: bool
) -> None:
    loss, found, begun = integrator(), sample_search.search_on_samples, list[torch.Tensor]()
    last, random = loss.actor_network.weights.clone(), random_policy(Draws(1))

    def noted(*arguments: object) -> object:
        begun.append(loss.actor_network.weights.clone())
        return found(*arguments)

    monkeypatch.setattr(sample_search, "search_on_samples", noted)
    promise = None if predicted is None else Scripted(predicted)
    settings = SearchSettings(2, 2, 2, sample_steps=3)
    search = TrialSearch(settings, lambda: random, generator(), promise)
    search.run(loss, INITIAL, None)
    assert len(begun) == 1 and torch.equal(begun[0], random.weights if anew else last)


def test_gradient_of_a_particle_is_bounded_by_the_spread_of_all_states() -> None:
    loss = integrator()
    units = sample_search._units(loss, INITIAL, generator())
    count = sample_search.PARTICLES
    functions = damped_integrator().functions(count, generator())
    given = functions, count, loss.dynamics, loss.space, loss.horizon, generator()
    states = sample_search.sample_consistent_rollouts(INITIAL, loss.actor_network, *given)
    spread = states.flatten(0, -2).std(0)
    assert_close(units, sample_search.PARTICLES * spread, rtol=0.2, atol=0)


ALONE = {  # predicted rates and costs of the last policy and of those found, and the one kept
    "success is predicted from half the starts": ((0.0, 0.5), (1.0, 2.0), 1),
    "progress": ((0.0, 0.0), (1.0, 0.7), 1),
    "progress where none was finite": ((0.0, 0.0), (math.inf, 1.0), 1),
    "a random policy leads further": ((0.0, 0.0, 0.4), (1.0, 0.9, 0.8), 2),
    "it does not": ((0.0, 0.0, 0.4), (1.0, 0.9, 0.95), 1),
    "the last one costs least": ((0.0, 0.0, 0.4), (1.0, 1.1, 1.2), 0),
    "it costs least, below zero": ((0.0, 0.0, 0.0), (-10.0, -9.0, -8.0), 0),
    "the last one succeeds most": ((0.9, 0.8), (1.0, 0.7), 0),
}


@pytest.mark.parametrize("case", ALONE)
def test_trial_on_samples_alone_begins_anew_without_progress_and_keeps_the_best(
    monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    rates, costs, kept = ALONE[case]
    loss, left = integrator(), iter(costs)
    monkeypatch.setattr(type(loss), "has_moments", property(lambda _: False))
    loss.actor_network.weights.data.zero_()
    leave_weights(monkeypatch, loss, [1, 2])
    monkeypatch.setattr(sample_search, "expected_cost", lambda *_: next(left))
    settings, random = SearchSettings(2, 2, 2, sample_steps=3), integrator().actor_network
    search = TrialSearch(settings, lambda: random, generator(), Scripted(*rates))
    search.load_state_dict({"least": costs[0]})
    result = search.run(loss, INITIAL, None)
    assert (loss.actor_network.weights == kept).all()
    assert result.evaluations == 3 * (len(costs) - 1) and search.result is result
    assert next(left, None) is None


@pytest.mark.parametrize(
    ("complete", "promised", "kept"),
    [
        (True, (0.9, 0.9, 0.95), 1),
        (True, (0.9, 0.9, 0.85), 0),
        (True, (1.0,), 0),
        (False, (0.9,), 0),
    ],
    ids=["samples succeed more", "moments do", "the promise is kept", "too far to be trusted"],
)
def test_search_of_a_cost_by_moments_ends_on_samples_where_it_breaks_its_promise(
    monkeypatch: pytest.MonkeyPatch, complete: bool, promised: tuple[float, ...], kept: int
) -> None:
    loss = make_cost(0)
    monkeypatch.setattr(SearchResult, "complete", property(lambda _: complete))
    monkeypatch.setattr(type(loss), "trusts_start", lambda *_: True)
    leave_weights(monkeypatch, loss, [1])
    make, promise = lambda: make_cost(0).actor_network, Scripted(*promised)
    start = Gaussian(Draws(2).normal(2), 1e-3 * torch.eye(2).double())
    search = TrialSearch(SearchSettings(1, 1, 1, sample_steps=0), make, generator(), promise)
    search.load_state_dict({"least": math.inf})
    search.run(loss, start, None)
    assert bool((loss.actor_network.weights == 1).all()) == kept
    assert promise.left == [promised[-1]]  # samples were searched only where they could help
