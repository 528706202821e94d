"""The searches of a trial: from which starts, in which order, and which policy is kept."""

from __future__ import annotations

import copy
import math
from itertools import islice

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.integrator import SPACE, belief_at_one, integrator_loss, random_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.search import success_search, trial_search
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchResult, SearchSettings, search_policy
from torch_pmil.search.promise import SAMPLES, PredictedSuccess, Promise
from torch_pmil.search.success_search import STEADYINGS, search_for_success, steady_policy
from torch_pmil.search.target_losses import ExpectedSaturatingCost
from torch_pmil.search.trial_search import BOLDER, PROGRESS, TrialSearch

HORIZON = 6

INITIAL = belief_at_one(0.04)
SETTINGS = SearchSettings(20, 20, 20, first_horizon=1 / 3, horizon_step=1 / 3, trust_threshold=0.5)
WIDE = 0.3  # m, standard deviation of what is demonstrated: as wide as no good policy need be
SHOWN = 0.75 ** torch.arange(1.0, HORIZON + 1, dtype=torch.float64)


@pytest.fixture
def loss() -> TrajectoryKLLoss:
    return integrator_loss(random_policy(Draws(0)), SHOWN, WIDE**2)


def distance(states: Tensor) -> Tensor:
    return (states[:, 1:, 0] - SHOWN).square().mean(-1).sqrt()


@torch.no_grad()
def test_policy_that_copies_the_spread_is_narrow_when_it_is_steadied(
    loss: TrajectoryKLLoss,
) -> None:
    def cross_entropy() -> float:
        return loss.cross_entropy_per_step(INITIAL).sum().item()

    result = search_policy(loss, INITIAL, SETTINGS)
    before, wide = cross_entropy(), loss.predict_states(INITIAL).std
    steadied = steady_policy(loss, INITIAL, SETTINGS)
    after, narrow = cross_entropy(), loss.predict_states(INITIAL).std
    assert after < before
    assert (narrow[2:] < 0.8 * wide[2:]).all()
    assert steadied.loss > result.loss
    assert steadied.loss == pytest.approx(loss.per_step(INITIAL).sum().item())


def test_steadied_policy_succeeds_more_often(loss: TrajectoryKLLoss) -> None:
    result, promise = search_policy(loss, INITIAL, SETTINGS), Promise(0.95, distance, 0.6 * WIDE)
    before = promise.predicted(loss, INITIAL)
    found = search_for_success(loss, INITIAL, promise, SETTINGS, result, 1000)
    after = promise.predicted(loss, INITIAL)
    assert before.least < promise.aim
    assert after.successes > before.successes
    assert found.evaluations > result.evaluations


class ScriptedPromise:
    """Predictions of success, one after the other."""

    aim = 0.9

    def __init__(self, *rates: float) -> None:
        self._rates = iter(rates)

    def predicted(self, *_: object) -> PredictedSuccess:
        return PredictedSuccess(round(next(self._rates) * SAMPLES))


def outcome(loss: float, horizon: int = HORIZON, matched: bool = True) -> SearchResult:
    """Of a search with 10 evaluations."""
    per_step = torch.full((HORIZON,), loss / HORIZON, dtype=torch.float64)
    return SearchResult(loss, per_step, horizon, matched, 10, 1, 0.5, "iteration limit")


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch, loss: TrajectoryKLLoss) -> list[str]:
    """Names of the searches that were made; the weights are then their number, and so is the KL."""
    made: list[str] = []

    def search(name: str) -> SearchResult:
        made.append(name)
        loss.actor_network.weights.data.fill_(len(made))
        return outcome(float(len(made)))

    monkeypatch.setattr(success_search, "search_policy", lambda *_: search("random"))
    monkeypatch.setattr(success_search, "steady_policy", lambda *_: search("steady"))
    loss.actor_network.weights.data.zero_()
    return made


def kept_by(loss: TrajectoryKLLoss) -> int:
    """Number of the search whose policy the loss holds."""
    return int(loss.actor_network.weights[0, 0].item())


def go_on(
    loss: TrajectoryKLLoss, restarts: int, *rates: float, credit: int = 1000
) -> tuple[int, SearchResult]:
    """Number of the search whose policy was kept, and the outcome."""
    policies = (random_policy(Draws(seed)) for seed in range(restarts))
    promise = ScriptedPromise(*rates)
    found = search_for_success(loss, INITIAL, promise, SETTINGS, outcome(0.0), credit, policies)
    return kept_by(loss), found


SUCCESSES = {  # restarts, rates, the searches made, and the number of the one kept
    "enough": (2, [1.0], [], 0),
    "steadied": (2, [0.5, 0.95], ["steady"], 1),
    "steadied again": (2, [0.5, 0.6, 0.6, 0.95], ["steady"] * 3, 3),
    "often enough": (0, [0.5] + [0.6] * STEADYINGS, ["steady"] * STEADYINGS, 1),
    "no restart": (0, [0.5, 0.6, 0.4], ["steady"] * 2, 1),
    "better restart": (1, [0.5, 0.4, 0.3, 0.7, 0.6], ["steady", "random", "steady", "steady"], 3),
    "at once": (2, [0.5, 0.4, 1.0], ["steady", "random"], 2),
    "hopeless": (1, [0.0, 0.001, 0.0, 0.95], ["steady", "random", "steady"], 3),
    "worse": (1, [0.5, 0.4, 0.2, 0.1], ["steady", "random", "steady"], 0),
}


@pytest.mark.parametrize("case", SUCCESSES)
def test_searches_follow_until_the_aim_is_reached_and_the_best_policy_is_kept(
    loss: TrajectoryKLLoss, scripted: list[str], case: str
) -> None:
    restarts, rates, made, kept = SUCCESSES[case]
    number, found = go_on(loss, restarts, *rates)
    assert (scripted, number, found.loss) == (made, kept, float(kept))
    assert found.evaluations == 10 * (1 + len(made))


def test_no_search_begins_once_the_evaluations_are_used_up(
    loss: TrajectoryKLLoss, scripted: list[str]
) -> None:
    number, found = go_on(loss, 2, 0.5, 0.6, 0.7, 0.8, credit=15)
    assert (scripted, number, found.evaluations) == (["steady"] * 2, 2, 30)


def test_cost_without_demonstrations_is_not_steadied(
    scripted: list[str], loss: TrajectoryKLLoss
) -> None:
    network = copy.deepcopy(loss.actor_network)
    cost = ExpectedSaturatingCost(network, loss.dynamics, SPACE, torch.zeros(1), 0.5, HORIZON)
    go_on(cost, 1, 0.1, 0.2)
    assert scripted == ["random"]


# the order of the searches


class Searches:
    """A trial search whose searches end with these results, one after the other.

    The policy's weights are then the number of the search, 1, 2, ...
    """

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        loss: TrajectoryKLLoss,
        results: list[tuple[float, int, bool]],
        restarts: int = 0,
    ) -> None:
        self.loss, self._results, self.searches = loss, iter(results), 0
        self.refitted_from: list[int] = []  # numbers of the searches whose policies were refitted
        self.random_at: list[int] = []  # and of those from a random policy
        self.bold_at: list[int] = []  # and of those with more trust
        self.optimizers: list[object] = []
        self.loss.actor_network.weights.data.zero_()
        monkeypatch.setattr(trial_search, "search_policy", self._search)
        monkeypatch.setattr(trial_search, "refit_policy", self._refit)
        self.search = TrialSearch(
            SearchSettings(restarts=restarts), self._random, torch.Generator(), optimizer=OPTIMIZER
        )

    def _random(self) -> RBFPolicy:
        policy = random_policy(Draws(0))
        policy.weights.data.fill_(-1)
        return policy

    def _refit(self, loss: TrajectoryKLLoss, _: object, new: RBFPolicy, *__: object) -> RBFPolicy:
        self.refitted_from.append(kept_by(loss))
        return new

    def _search(
        self,
        loss: TrajectoryKLLoss,
        *_: object,
        settings: SearchSettings,
        random: bool = False,
        optimizer: object,
        **__: object,
    ) -> SearchResult:
        assert not random or kept_by(loss) in (-1, 0)
        self.searches += 1
        usual = SearchSettings().trust_threshold
        self.bold_at += [self.searches] if settings.trust_threshold == BOLDER * usual else []
        self.random_at += [self.searches] if random else []
        self.optimizers.append(optimizer)
        loss.actor_network.weights.data.fill_(self.searches)
        return outcome(*next(self._results))

    def trial(self, succeeded: bool = True) -> int:
        """Number of the search whose policy one trial keeps, after a rollout."""
        self.search.run(self.loss, INITIAL, succeeded)
        return kept_by(self.loss)


OPTIMIZER = torch.optim.Adam
SLOW = 1.1 * PROGRESS * 100  # after a search that came to 100


def short(*losses: float) -> list[tuple[float, int, bool]]:
    """Results of searches that end at the first two steps."""
    return [(loss, 2, False) for loss in losses]


COMPLETE = (SLOW, HORIZON, True)
ORDERS = {  # results, restarts, succeeded, kept, refitted from, with more trust at, random at
    "well below": (short(100, 0.9 * PROGRESS * 100), 0, True, [1, 2], [], [], [1]),
    "complete": ([*short(100), COMPLETE], 0, True, [1, 2], [], [], [1]),
    "a failed rollout": ([(100, 6, True), COMPLETE, (1, 6, True)], 0, False, [1, 3], [2], [], [1]),
    "renewal is better": (short(100, SLOW, 50), 0, True, [1, 3], [2], [], [1]),
    "trust is better": (short(100, SLOW, 99, 50), 0, True, [1, 4], [2], [4], [1]),
    "neither is": (short(100, SLOW, 99, 98), 0, True, [1, 2], [2], [4], [1]),
    "random": (short(100, SLOW, SLOW, 99, 98, 50), 3, True, [1, 6], [2], [4], [1, 5, 6]),
    "least of all": (short(100, 150, 140, 145, SLOW, 95, 96), 0, 1, [1, 3, 5], [2, 5], [4, 7], [1]),
    "a prediction that fails is no progress": (short(math.inf, 50), 0, None, [2], [1], [], [1]),
}


@pytest.mark.parametrize("case", ORDERS)
def test_searches_follow_until_one_brings_enough_and_the_best_is_kept(
    monkeypatch: pytest.MonkeyPatch, loss: TrajectoryKLLoss, case: str
) -> None:
    results, restarts, succeeded, kept, *made = ORDERS[case]
    scripted = Searches(monkeypatch, loss, results, restarts)
    begun = []
    assert [begun.append(scripted.searches) or scripted.trial(succeeded) for _ in kept] == kept
    assert [scripted.refitted_from, scripted.bold_at, scripted.random_at] == made
    assert scripted.searches == len(results)
    last = len(results) - begun[-1]
    result = scripted.search.result
    assert (result.evaluations, result.failures, result.seconds) == (10 * last, last, 0.5 * last)
    assert result.loss == results[kept[-1] - 1][0]
    assert scripted.search.refitted == (last > 1)
    assert scripted.optimizers == [OPTIMIZER] * len(results)


def test_searches_for_success_take_as_many_evaluations_as_the_others_of_the_run(
    monkeypatch: pytest.MonkeyPatch, loss: TrajectoryKLLoss
) -> None:
    """And are from random policies only after a rollout that succeeded."""
    scripted = Searches(monkeypatch, loss, [(1.0, HORIZON, True)] * 4)
    given: list[tuple[int, int]] = []

    def counted(*arguments: object) -> SearchResult:
        result, credit, policies = arguments[4:7]
        given.append((credit, len(list(islice(policies, 3)))))
        return result.with_work_of(outcome(1.0)) if len(given) == 2 else result

    monkeypatch.setattr(trial_search, "search_for_success", counted)
    scripted.search.promise = ScriptedPromise()
    for succeeded in (None, False, True, True):
        monkeypatch.setattr(scripted.search, "_least", 100.0)
        scripted.trial(succeeded)
    assert given == [(10, 0), (20, 0), (20, 3), (30, 3)]  # the second search took 10
