"""The search on sampled trajectories: its costs, its steps, and which policy a trial keeps."""

from __future__ import annotations

import math

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
from tests.search.test_trial_search import SLOW, Searches, short
from torch_pmil.gp.lbfgs import MinimiseResult
from torch_pmil.search import sample_search, trial_search
from torch_pmil.search.losses import FAR, TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.sample_search import search_on_samples
from torch_pmil.search.saturating_cost import saturating_cost

HORIZON = 6
INITIAL = belief_at_one(0.04)
SHOWN = 0.75 ** torch.arange(1.0, HORIZON + 1, dtype=torch.float64)


def integrator() -> TrajectoryKLLoss:
    return integrator_loss(random_policy(Draws(0)), SHOWN, 0.05**2)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_cost_of_a_sample_is_the_logarithm_of_its_distance(draws: Draws) -> None:
    loss = make_kl(0)
    states = draws.normal(5, loss.horizon, 2)
    offset = loss.space.observe(states) - loss.demonstrated_mean
    square = torch.einsum(
        "nti,tij,ntj->nt", offset, torch.linalg.inv(loss.demonstrated_cov), offset
    )
    assert_close(loss.sample_costs(states), (1 + square / (2 * FAR)).log())


def test_cost_of_a_sample_away_from_a_target_saturates(draws: Draws) -> None:
    loss = make_cost(0)
    states = draws.normal(5, loss.horizon, 2)
    expected = saturating_cost((loss.space.observe(states) - loss.target) @ loss.to_widths.mT)
    assert_close(loss.sample_costs(states), expected)


def test_search_brings_the_samples_near_what_was_demonstrated() -> None:
    """The policy then matches it by exact moments too, and the same seed finds the same policy."""
    found = []
    for _ in range(2):
        loss = integrator()
        kl = loss.per_step(INITIAL).sum().item()
        result = search_on_samples(loss, INITIAL, 150, generator())
        assert result.evaluations == 150 and result.loss < 0.2 * result.initial_loss
        assert loss.per_step(INITIAL).sum().item() < 0.5 * kl
        assert all(parameter.grad is None for parameter in loss.actor_network.parameters())
        found.append(loss.actor_network.weights.detach())
    assert torch.equal(*found)


def test_search_ends_before_a_step_that_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    loss, steps = integrator(), iter([1.0, 1.0, math.nan])
    costs = loss.sample_costs
    monkeypatch.setattr(loss, "sample_costs", lambda states: next(steps) * costs(states))
    result = search_on_samples(loss, INITIAL, 5, generator())
    assert (result.iterations, result.failures, result.stop_reason) == (2, 1, "numerical failure")
    assert all(parameter.isfinite().all() for parameter in loss.actor_network.parameters())


STUCK = {  # losses of the searches of the second trial, the one kept, samples, refits
    "progress": ([50], 2, 0, 0),
    "samples help": ([SLOW, 50], 3, 1, 0),
    "they do not": ([SLOW, 99, 98, 97], 2, 1, 1),
}


@pytest.mark.parametrize("case", STUCK)
def test_stuck_search_begins_anew_after_samples(monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    losses, kept, samples, refits = STUCK[case]
    scripted = Searches(monkeypatch, integrator(), short(100, *losses))
    scripted.search.settings = SearchSettings(sample_steps=3)
    steps: list[int] = []

    def on_samples(_: object, __: object, count: int, ___: object) -> MinimiseResult:
        steps.append(count)
        return MinimiseResult(2.0, 1.0, count, count, 0, "iteration limit")

    monkeypatch.setattr(trial_search, "search_on_samples", on_samples)
    assert [scripted.trial(), scripted.trial()] == [1, kept]
    assert steps == [3] * samples and len(scripted.refitted_from) == refits
    assert scripted.search.result.evaluations == 10 * len(losses) + 3 * samples


def test_gradient_of_a_particle_is_bounded_by_the_spread_of_all_states() -> None:
    loss = integrator()
    units = sample_search._units(loss, INITIAL, generator())
    functions = sample_search.FunctionSamples.draw(
        damped_integrator(), sample_search.PARTICLES, generator()
    )
    given = functions, loss.dynamics, loss.space, loss.horizon, generator()
    states = sample_search.sample_consistent_rollouts(INITIAL, loss.actor_network, *given)
    spread = states.flatten(0, -2).std(0)
    assert_close(units, sample_search.PARTICLES * spread, rtol=0.2, atol=0)
