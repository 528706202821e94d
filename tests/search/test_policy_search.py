"""The policy search on a damped integrator."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.integrator import (
    SPACE,
    U_MAX,
    belief_at_one,
    damped_integrator,
    integrator_loss,
    random_policy,
)
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.model.rollout import PredictionError, predict_mean_trajectory, predict_trajectory
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import (
    WORTHWHILE,
    SearchResult,
    SearchSettings,
    evaluate_steps,
    refit_policy,
    search_policy,
)
from torch_pmil.search.target_losses import ExpectedSaturatingCost

HORIZON = 6

SETTINGS = SearchSettings(5, 5, 5, first_horizon=1 / 3, horizon_step=1 / 3, trust_threshold=1.0)
SHORTEST = replace(SETTINGS, mean_iterations=1, stage_iterations=1, final_iterations=1)
INITIAL = belief_at_one(0.01)
REACHABLE = 0.75 ** torch.arange(1.0, HORIZON + 1, dtype=torch.float64)


def make_loss(mean: Tensor = REACHABLE) -> TrajectoryKLLoss:
    """Demonstrated marginals of that mean (T,) and a standard deviation of 0.14."""
    return integrator_loss(random_policy(Draws(seed=0)), mean, 0.02)


@pytest.fixture
def loss() -> TrajectoryKLLoss:
    """What the demonstrated shows can be reached; the random policy does not."""
    return make_loss()


@pytest.fixture
def hopeless() -> TrajectoryKLLoss:
    """From step 4 on the demonstrated is where no torque leads."""
    return make_loss(REACHABLE + 10 * (torch.arange(HORIZON) >= 3))


@dataclass(frozen=True)
class Search:
    """A search, with what was reported and the policy's parameters that it left."""

    result: SearchResult
    reports: list[tuple[str, float]]
    parameters: dict[str, Tensor]


def search(
    loss: TrajectoryKLLoss, settings: SearchSettings = SETTINGS, random: bool = False
) -> Search:
    reports: list[tuple[str, float]] = []
    result = search_policy(loss, INITIAL, settings, lambda *report: reports.append(report), random)
    return Search(result, reports, copy.deepcopy(loss.actor_network.state_dict()))


@pytest.fixture(scope="module")
def finished() -> Search:
    """The search on ``loss``."""
    return search(make_loss())


@pytest.fixture
def found(loss: TrajectoryKLLoss, finished: Search) -> TrajectoryKLLoss:
    """The loss with the policy that the search found."""
    loss.actor_network.load_state_dict(finished.parameters)
    return loss


def test_search_lowers_the_kl_until_the_whole_horizon_is_matched(
    loss: TrajectoryKLLoss, finished: Search
) -> None:
    result = finished.result
    assert result.loss < 0.5 * loss.per_step(INITIAL).sum().item()
    assert result.converged and result.horizon == HORIZON
    assert (result.per_step < SETTINGS.trust_threshold).all()


def test_result_is_that_of_the_policy_that_is_left(
    found: TrajectoryKLLoss, finished: Search
) -> None:
    assert torch.equal(finished.result.per_step, found.per_step(INITIAL).detach())
    assert finished.result.loss == finished.result.per_step.sum().item()
    assert finished.result.seconds > 0


def horizons(search: Search, objective: str) -> list[int]:
    """Horizons of the runs of L-BFGS on "mean" or "KL", as they were reported."""
    assert all(stage.endswith(f"/{HORIZON}") for stage, _ in search.reports)
    stages = [stage.split() for stage, _ in search.reports]
    return [int(steps.partition("/")[0]) for name, steps in stages if name == objective]


def test_horizon_grows_step_by_step_each_with_a_run_on_the_mean_and_then_the_kl(
    finished: Search,
) -> None:
    grown = [f"{objective} {horizon}/6" for horizon in (2, 4, 6) for objective in ("mean", "KL")]
    assert [stage for stage, _ in finished.reports] == [*grown, "KL 6/6"]
    assert finished.reports[-1][1] == pytest.approx(finished.result.loss)


@pytest.mark.parametrize(
    ("first", "step", "expected"),
    [(1 / 3, 1 / 2, [2, 5, 6]), (2 / 3, 1.0, [4, 6]), (1.0, 1 / 2, [6])],
)
def test_horizon_never_exceeds_that_of_the_expert(
    loss: TrajectoryKLLoss, first: float, step: float, expected: list[int]
) -> None:
    settings = SearchSettings(3, 3, 1, first_horizon=first, horizon_step=step, trust_threshold=1.0)
    assert horizons(search(loss, settings), "mean") == expected


def test_policy_that_matches_is_searched_on_the_whole_kl_alone(found: TrajectoryKLLoss) -> None:
    once = search(found, SHORTEST)
    assert (horizons(once, "KL"), horizons(once, "mean")) == ([6], [])


@pytest.mark.parametrize(
    ("skip_matched_steps", "random", "expected"),
    [(False, True, [2, 4, 6]), (False, False, []), (True, True, [])],
)
def test_horizon_of_a_trusted_random_policy_grows_unless_matched_steps_are_skipped(
    found: TrajectoryKLLoss, skip_matched_steps: bool, random: bool, expected: list[int]
) -> None:
    settings = replace(SHORTEST, skip_matched_steps=skip_matched_steps)
    assert horizons(search(found, settings, random), "mean") == expected


@pytest.mark.parametrize(
    ("skip_matched_steps", "expected"), [(True, [2, 6]), (False, [2, 3, 4, 5, 6])]
)
def test_horizon_that_skips_matched_steps_begins_where_they_end(
    loss: TrajectoryKLLoss,
    monkeypatch: pytest.MonkeyPatch,
    skip_matched_steps: bool,
    expected: list[int],
) -> None:
    doubts = iter([torch.full((HORIZON,), 9.0), *[torch.zeros(HORIZON)] * 10])
    monkeypatch.setattr(loss, "step_loss_for_trust", lambda *_: next(doubts))
    settings = replace(SHORTEST, horizon_step=1 / 6, skip_matched_steps=skip_matched_steps)
    assert horizons(search(loss, settings), "mean") == expected


@pytest.mark.parametrize(("sure", "used"), [(True, "spread"), (False, "step_loss_for_trust")])
def test_step_is_trusted_where_its_prediction_is_sure_or_where_it_matches(
    loss: TrajectoryKLLoss, monkeypatch: pytest.MonkeyPatch, sure: bool, used: str
) -> None:
    """By the one measure nothing is trusted at first, and then all; the other is not asked."""
    doubts = iter([torch.full((HORIZON,), 9.0), *[torch.zeros(HORIZON)] * 10])
    for name in ("spread", "step_loss_for_trust"):
        monkeypatch.setattr(loss, name, None)
    monkeypatch.setattr(loss, used, lambda *_: next(doubts))
    settings = replace(SHORTEST, trust_what_is_sure=sure)
    assert horizons(search(loss, settings), "mean") == [2, 6]


def test_horizon_stops_where_the_last_steps_are_not_trusted(hopeless: TrajectoryKLLoss) -> None:
    result = search(hopeless).result
    assert (result.horizon, result.converged) == (4, False)
    assert result.per_step.shape == (HORIZON,)
    assert result.per_step[2:4].mean() > SETTINGS.trust_threshold


@pytest.mark.parametrize(("threshold", "horizon"), [(1e-9, 2), (0.5, HORIZON)])
def test_costly_prediction_is_followed_as_far_as_it_is_sure(
    draws: Draws, threshold: float, horizon: int
) -> None:
    """The target is out of reach: every step costs more than may be doubted."""
    parts, target = (random_policy(draws), damped_integrator(), SPACE), torch.tensor([5.0])
    cost = ExpectedSaturatingCost(*parts, target, width=1.5, horizon=HORIZON)
    settings = SearchSettings(2, 2, 1, 1 / 3, horizon_step=1 / 3, trust_threshold=threshold)
    result = search(cost, settings).result
    assert (result.per_step > 0.5).all()
    assert (result.horizon, result.complete) == (horizon, horizon == HORIZON)


def test_same_start_gives_the_same_search_and_the_model_stays(
    loss: TrajectoryKLLoss, finished: Search
) -> None:
    before = copy.deepcopy(loss.dynamics.state_dict())
    again = search(loss).result
    assert torch.equal(again.per_step, finished.result.per_step)
    assert again.evaluations == finished.result.evaluations
    after = loss.dynamics.state_dict()
    assert all(torch.equal(value, before[name]) for name, value in after.items())


def fail_beyond(loss: TrajectoryKLLoss, step: int, monkeypatch: pytest.MonkeyPatch) -> Tensor:
    """Predictions longer than ``step`` fail in the next one; returns those that are left."""
    per_step = loss.per_step

    def failing(initial: Gaussian, horizon: int | None = None) -> Tensor:
        if (horizon or HORIZON) > step:
            raise PredictionError(f"prediction of step {step + 1} failed", step + 1)
        return per_step(initial, horizon)

    monkeypatch.setattr(loss, "per_step", failing)
    return per_step(INITIAL, step).detach() if step else torch.empty(0)


@pytest.mark.parametrize("step", [1, 3, 5])
def test_steps_beyond_a_failed_prediction_cost_infinitely_much(
    loss: TrajectoryKLLoss, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    known = fail_beyond(loss, step, monkeypatch)
    evaluated = evaluate_steps(loss.per_step, INITIAL, HORIZON)
    assert torch.equal(evaluated[:step], known)
    assert evaluated[step:].tolist() == [math.inf] * (HORIZON - step)


def test_failure_of_the_first_step_is_an_error(
    loss: TrajectoryKLLoss, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_beyond(loss, 0, monkeypatch)
    with pytest.raises(PredictionError, match="prediction of step 1 failed"):
        search_policy(loss, INITIAL, SETTINGS)


@pytest.mark.parametrize(("known", "threshold"), [(3, 0.0), (3, 1.0), (4, 1.0)])
def test_search_goes_on_as_far_as_the_prediction_can_be_followed(
    loss: TrajectoryKLLoss, monkeypatch: pytest.MonkeyPatch, known: int, threshold: float
) -> None:
    """The first three steps are matched or not trusted; beyond ``known`` the prediction fails."""
    fail_beyond(loss, known, monkeypatch)
    settings = SearchSettings(5, 5, 1, first_horizon=1 / 2, trust_threshold=threshold)
    result = search(loss, settings).result
    assert (result.horizon, result.converged, result.loss) == (known, threshold > 0, math.inf)
    assert result.per_step[:known].isfinite().all()


@pytest.mark.parametrize(
    "error",
    [PredictionError("no Cholesky factor", 2), NotPositiveDefiniteError("no Cholesky factor")],
)
def test_failures_within_a_run_are_survived_and_counted(
    loss: TrajectoryKLLoss, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    mean_per_step, calls = loss.mean_per_step, []

    def failing_once(initial: Gaussian, horizon: int) -> Tensor:
        calls.append(horizon)
        if len(calls) == 2:
            raise error
        return mean_per_step(initial, horizon)

    monkeypatch.setattr(loss, "mean_per_step", failing_once)
    result = search(loss, SearchSettings(5, 1, 1, first_horizon=1.0, trust_threshold=0.0)).result
    assert result.failures == 1
    assert result.evaluations > len(calls) > 2


def refitted(
    loss: TrajectoryKLLoss, settings: SearchSettings = SETTINGS
) -> tuple[Tensor, Tensor, RBFPolicy]:
    """Actions before and after along the old policy's mean, x_0 first, and the policy drawn."""
    draws = Draws(seed=5)
    drawn, policy = random_policy(draws), loss.actor_network
    old = copy.deepcopy(policy.state_dict())
    mean = predict_mean_trajectory(INITIAL.mean, policy, loss.dynamics, SPACE, HORIZON)
    features = SPACE.features(torch.cat([INITIAL.mean[None], mean])).detach()
    new = refit_policy(loss, INITIAL, copy.deepcopy(drawn), settings, draws.generator)
    assert all(torch.equal(value, old[name]) for name, value in policy.state_dict().items())
    assert torch.equal(new.centres, drawn.centres)
    assert torch.equal(new.log_widths, drawn.log_widths)
    return policy(features).detach(), new(features).detach(), drawn


def test_refitted_policy_acts_nearly_as_the_old_one_along_the_prediction(
    found: TrajectoryKLLoss,
) -> None:
    before, after, drawn = refitted(found)
    apart = (after - before).abs().max()
    assert apart < 0.05 * U_MAX
    features = SPACE.features(INITIAL.mean)
    assert (drawn(features) - before[0]).abs() > 4 * apart
    assert torch.equal(refitted(found)[1], after), "with the same seed"


@pytest.mark.parametrize(
    ("threshold", "same"), [(0.0, True), (1e9, False)], ids=["nowhere", "everywhere"]
)
def test_policy_is_refitted_at_the_start_and_where_the_prediction_is_trusted(
    found: TrajectoryKLLoss, threshold: float, same: bool
) -> None:
    """What a model predicts matters only where it is trusted."""
    other = copy.deepcopy(found)
    other.dynamics.set_data(other.dynamics.train_inputs, -other.dynamics.train_targets)
    settings = SearchSettings(first_horizon=1 / 6, trust_threshold=threshold)

    def weights(loss: TrajectoryKLLoss) -> Tensor:
        new, generator = random_policy(Draws(seed=5)), Draws(seed=6).generator
        return refit_policy(loss, INITIAL, new, settings, generator).weights

    assert torch.equal(weights(found), weights(other)) == same


def test_without_iterations_of_the_mean_each_horizon_begins_with_the_loss(
    loss: TrajectoryKLLoss,
) -> None:
    before = loss.per_step(INITIAL).sum().item()
    found = search(loss, replace(SETTINGS, mean_iterations=0))
    assert horizons(found, "mean") == []
    assert horizons(found, "KL")[:2] == [2, 4]
    assert found.result.loss < 0.5 * before


def test_policy_whose_prediction_fails_early_is_renewed_as_far_as_it_can_be_followed(
    found: TrajectoryKLLoss,
) -> None:
    def failing(*arguments: object) -> Gaussian:
        if arguments[-1] > 2:
            raise PredictionError("prediction of step 3 failed", 3)
        return predict_trajectory(*arguments)

    found.prediction = failing
    before, after, _ = refitted(found, replace(SETTINGS, first_horizon=1.0))
    assert (after - before)[:3].abs().max() < 0.05 * U_MAX


def test_horizon_that_is_not_trusted_is_searched_on_while_that_lowers_the_loss(
    hopeless: TrajectoryKLLoss,
) -> None:
    """On a horizon with step 4, while runs of two iterations bring a tenth."""
    settings = SearchSettings(1, 2, 1, first_horizon=2 / 3, horizon_step=1 / 6, trust_threshold=1.0)
    found = search(hopeless, settings)
    reached = [loss for name, loss in found.reports[:-1] if name == f"KL 4/{HORIZON}"]
    falls = [after / before for before, after in pairwise(reached)]
    assert len(falls) > 1
    assert all(fall < WORTHWHILE for fall in falls[:-1])
    assert falls[-1] >= WORTHWHILE
    assert found.result.horizon == 4


def test_another_optimiser_searches_too(loss: TrajectoryKLLoss, finished: Search) -> None:
    before = loss.per_step(INITIAL).sum().item()
    adam = partial(torch.optim.Adam, lr=0.05)
    result = search_policy(loss, INITIAL, SETTINGS, optimizer=adam)
    assert result.loss < 0.9 * before
    assert result.loss == loss.per_step(INITIAL).sum().item() != finished.result.loss
