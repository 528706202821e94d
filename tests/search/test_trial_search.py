"""The search that goes on where a policy matches the demonstrations and yet fails too often."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.integrator import damped_integrator
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search import success_search
from torch_pmil.search.losses import ExpectedSaturatingCost, TrajectoryKLLoss
from torch_pmil.search.policy_search import SearchResult, SearchSettings, search_policy
from torch_pmil.search.promise import SAMPLES, PredictedSuccess, Promise
from torch_pmil.search.trial_search import STEADYINGS, search_for_success, steady_policy

HORIZON, U_MAX = 6, torch.tensor([2.0], dtype=torch.float64)
SPACE = StateSpace(("x",), ("m",), (), joint_match(("x",), ("m",)))
INITIAL = Gaussian(torch.ones(1).double(), torch.full((1, 1), 0.04).double())
SETTINGS = SearchSettings(20, 20, 20, first_horizon=2, horizon_step=2, trust_threshold=1.0)
WIDE = 0.3  # m, standard deviation of what is demonstrated: as wide as no good policy need be
SHOWN = 0.75 ** torch.arange(1.0, HORIZON + 1, dtype=torch.float64)


def make_policy(seed: int = 0) -> RBFPolicy:
    draws = Draws(seed)
    policy = RBFPolicy(draws.uniform(-1.5, 1.5, 8, 1), U_MAX, torch.ones(1))
    policy.weights.data.copy_(0.1 * draws.normal(8, 1))
    return policy


@pytest.fixture
def loss() -> TrajectoryKLLoss:
    demonstrated = Gaussian(SHOWN[:, None], torch.full((HORIZON, 1, 1), WIDE**2).double())
    return TrajectoryKLLoss(make_policy(), damped_integrator(), SPACE, demonstrated, noise_std=0.05)


@pytest.fixture
def searched(loss: TrajectoryKLLoss) -> tuple[TrajectoryKLLoss, SearchResult]:
    return loss, search_policy(loss, INITIAL, SETTINGS)


def distance(states: Tensor) -> Tensor:
    return (states[:, 1:, 0] - SHOWN).square().mean(-1).sqrt()


def cross_entropy(loss: TrajectoryKLLoss) -> float:
    with torch.no_grad():
        return loss.cross_entropy_per_step(INITIAL).sum().item()


def test_policy_that_copies_the_spread_is_narrow_when_it_is_steadied(
    searched: tuple[TrajectoryKLLoss, SearchResult],
) -> None:
    loss, result = searched
    with torch.no_grad():
        before, wide = cross_entropy(loss), loss.predict_states(INITIAL).std
        steadied = steady_policy(loss, INITIAL, SETTINGS)
        after, narrow = cross_entropy(loss), loss.predict_states(INITIAL).std
    assert after < before
    assert (narrow[2:] < 0.8 * wide[2:]).all()
    assert steadied.loss > result.loss
    with torch.no_grad():
        assert steadied.loss == pytest.approx(loss.per_step(INITIAL).sum().item())


def test_steadied_policy_succeeds_more_often(
    searched: tuple[TrajectoryKLLoss, SearchResult],
) -> None:
    loss, result = searched
    promise = Promise(0.95, distance, 0.6 * WIDE)
    before = promise.predicted(loss, INITIAL)
    found = search_for_success(loss, INITIAL, promise, SETTINGS, result)
    after = promise.predicted(loss, INITIAL)
    assert before.least < promise.aim
    assert after.successes > before.successes
    assert found.evaluations > result.evaluations


class Scripted:
    """Predictions of success, one after the other."""

    aim = 0.9

    def __init__(self, *rates: float) -> None:
        self._rates = iter(rates)

    def predicted(self, *_: object) -> PredictedSuccess:
        return PredictedSuccess(round(next(self._rates) * SAMPLES))


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch, loss: TrajectoryKLLoss) -> list[str]:
    """Names of the searches that were made; the weights are then their number."""
    made: list[str] = []

    def result(number: int) -> SearchResult:
        loss.actor_network.weights.data.fill_(number)
        per_step = torch.ones(HORIZON, dtype=torch.float64)
        return SearchResult(float(number), per_step, HORIZON, True, 10, 0, 0.5, "iteration limit")

    def search(name: str) -> SearchResult:
        made.append(name)
        return result(len(made))

    monkeypatch.setattr(success_search, "search_policy", lambda *_, **__: search("random"))
    monkeypatch.setattr(success_search, "steady_policy", lambda *_: search("steady"))
    result(0)
    return made


def go_on(loss: TrajectoryKLLoss, restarts: int, *rates: float) -> tuple[int, SearchResult]:
    """Number of the search whose policy was kept, and the outcome."""
    first = SearchResult(0.0, torch.ones(HORIZON), HORIZON, True, 10, 0, 0.5, "iteration limit")
    policies = (make_policy(seed) for seed in range(restarts))
    found = search_for_success(loss, INITIAL, Scripted(*rates), SETTINGS, first, policies)
    return int(loss.actor_network.weights[0, 0].item()), found


@pytest.mark.parametrize(
    ("restarts", "rates", "made", "kept"),
    [
        (2, [1.0], [], 0),
        (2, [0.5, 0.95], ["steady"], 1),
        (2, [0.5, 0.6, 0.6, 0.95], ["steady"] * 3, 3),
        (0, [0.5] + [0.6] * STEADYINGS, ["steady"] * STEADYINGS, 1),
        (0, [0.5, 0.6, 0.4], ["steady"] * 2, 1),
        (1, [0.5, 0.4, 0.3, 0.7, 0.6], ["steady", "random", "steady", "steady"], 3),
        (2, [0.5, 0.4, 1.0], ["steady", "random"], 2),
        (1, [0.5, 0.4, 0.2, 0.1], ["steady", "random", "steady"], 0),
    ],
    ids=[
        "enough",
        "steadied",
        "steadied again",
        "often enough",
        "no restart",
        "better restart",
        "at once",
        "worse",
    ],
)
def test_searches_follow_until_the_aim_is_reached_and_the_best_policy_is_kept(
    loss: TrajectoryKLLoss,
    scripted: list[str],
    restarts: int,
    rates: list[float],
    made: list[str],
    kept: int,
) -> None:
    number, found = go_on(loss, restarts, *rates)
    assert (scripted, number, found.loss) == (made, kept, float(kept))
    assert found.evaluations == 10 * (1 + len(made))


def test_cost_without_demonstrations_is_not_steadied(
    scripted: list[str], loss: TrajectoryKLLoss
) -> None:
    network = copy.deepcopy(loss.actor_network)
    cost = ExpectedSaturatingCost(network, loss.dynamics, SPACE, torch.zeros(1), 0.5, HORIZON)
    go_on(cost, 1, 0.1, 0.2)
    assert scripted == ["random"]
