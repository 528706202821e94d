"""The searches of a trial: from which starts, in which order, and which policy is kept."""

from __future__ import annotations

import copy
import math

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.integrator import belief_at_one, integrator_loss, random_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.rollout import PredictionError
from torch_pmil.search import success_search, trial_search
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchResult, SearchSettings, search_policy
from torch_pmil.search.promise import SAMPLES, PredictedSuccess, Promise
from torch_pmil.search.success_search import STEADYINGS, WIDER, search_for_success, steady_policy
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


def test_policy_steadied_for_wider_starts_succeeds_from_more_of_them(
    loss: TrajectoryKLLoss,
) -> None:
    """The outcome is that of the starts as they are."""
    search_policy(loss, INITIAL, SETTINGS)
    found, promise = copy.deepcopy(loss.actor_network.state_dict()), Promise(0.95, distance, WIDE)
    outer, rates = Gaussian(INITIAL.mean, 9 * INITIAL.cov), []
    for wider in (1.0, 3.0):
        loss.actor_network.load_state_dict(found)
        steadied = steady_policy(loss, INITIAL, SETTINGS, wider=wider)
        assert steadied.loss == pytest.approx(loss.per_step(INITIAL).sum().item())
        rates.append(promise.predicted(loss, outer).successes)
    assert rates[1] > rates[0]


def test_steadied_policy_succeeds_more_often(loss: TrajectoryKLLoss) -> None:
    result, promise = search_policy(loss, INITIAL, SETTINGS), Promise(0.95, distance, 0.6 * WIDE)
    before = promise.predicted(loss, INITIAL)
    found = search_for_success(loss, INITIAL, promise, SETTINGS, result)
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


def outcome(
    loss: float, horizon: int = HORIZON, matched: bool = True, evaluations: int = 10
) -> SearchResult:
    """Of a search with that many evaluations."""
    per_step = torch.full((HORIZON,), loss / HORIZON, dtype=torch.float64)
    return SearchResult(loss, per_step, horizon, matched, evaluations, 1, 0.5, "iteration limit")


@pytest.fixture
def steadied(monkeypatch: pytest.MonkeyPatch, loss: TrajectoryKLLoss) -> list[SearchResult]:
    """The searches that were made; the weights are then their number, and so is the KL."""
    made: list[SearchResult] = []

    def search(*given: object) -> SearchResult:
        made.append(outcome(float(len(made) + 1)))
        assert given[-1] == 1 + WIDER * (len(made) - 1)
        loss.actor_network.weights.data.fill_(len(made))
        return made[-1]

    monkeypatch.setattr(success_search, "steady_policy", search)
    loss.actor_network.weights.data.zero_()
    return made


def kept_by(loss: TrajectoryKLLoss) -> int:
    """Number of the search whose policy the loss holds."""
    return int(loss.actor_network.weights[0, 0].item())


SUCCESSES = {  # rates, the number of searches made, and of the one kept
    "enough": ([1.0], 0, 0),
    "steadied": ([0.5, 0.95], 1, 1),
    "again": ([0.5, 0.6, 0.6, 0.95], 3, 3),
    "often enough": ([0.5] + [0.6] * STEADYINGS, STEADYINGS, 1),
    "worse": ([0.5, 0.6, 0.4], 2, 1),
    "hardly worse": ([0.5, 0.6, 0.59, 0.95], 3, 3),
    "hopeless": ([0.0, 0.001], 1, 0),
}


@pytest.mark.parametrize("case", SUCCESSES)
def test_policy_is_steadied_until_the_aim_is_reached_and_the_best_is_kept(
    loss: TrajectoryKLLoss, steadied: list[SearchResult], case: str
) -> None:
    rates, made, kept = SUCCESSES[case]
    found = search_for_success(loss, INITIAL, ScriptedPromise(*rates), SETTINGS, outcome(0.0))
    assert (len(steadied), kept_by(loss), found.loss) == (made, kept, float(kept))
    assert found.evaluations == 10 + 10 * made


def test_best_policy_is_kept_where_wider_starts_cannot_be_predicted(
    loss: TrajectoryKLLoss, steadied: list[SearchResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    search = success_search.steady_policy

    def failing(*given: object) -> SearchResult:
        if len(steadied) == 2:
            loss.actor_network.weights.data.fill_(9.0)
            raise PredictionError("too wide", 1)
        return search(*given)

    monkeypatch.setattr(success_search, "steady_policy", failing)
    found = search_for_success(
        loss, INITIAL, ScriptedPromise(0.5, 0.7, 0.69), SETTINGS, outcome(0.0)
    )
    assert (len(steadied), kept_by(loss), found.loss) == (2, 1, 1.0)


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


@pytest.mark.parametrize("complete", [True, False])
def test_success_is_searched_once_the_whole_horizon_is_matched(
    monkeypatch: pytest.MonkeyPatch, loss: TrajectoryKLLoss, complete: bool
) -> None:
    scripted = Searches(monkeypatch, loss, [(1.0, HORIZON if complete else 2, complete)] * 3)
    found = outcome(2.0)
    monkeypatch.setattr(trial_search, "search_for_success", lambda *_: found)
    scripted.search.promise = ScriptedPromise()
    scripted.trial(None)
    assert (scripted.search.result is found) == complete
