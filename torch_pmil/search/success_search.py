"""Search on where a policy matches the demonstrations, and yet fails from too many starts."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator

from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import (
    SearchResult,
    SearchRuns,
    SearchSettings,
    search_policy,
)
from torch_pmil.search.promise import Promise
from torch_pmil.search.trajectory_loss import TrajectoryLoss

Report = Callable[[str, float], None]


def search_for_success(
    loss: TrajectoryLoss,
    initial: Gaussian,
    promise: Promise,
    settings: SearchSettings,
    make_policy: Callable[[], RBFPolicy],
    result: SearchResult,
    restarts: int,
    report: Report = lambda stage, loss: None,
) -> SearchResult:
    """Search on until the predicted success rate of the policy is :attr:`Promise.aim`.

    The policy is steadied first (:func:`steady_policy`), if the loss is a KL. Then others are
    searched from random policies, and steadied too. The policy with the highest predicted rate is
    kept, of several alike the one of least loss.

    Args:
        loss: objective with the policy (changed in place) and the model.
        initial: p(x_0).
        promise: what the policy shall keep.
        settings: budget and horizon of the searches.
        make_policy: returns a new random policy of the same shape.
        result: of the search that found the policy, which matches the whole horizon.
        restarts: largest number of searches from random policies.
        report: as of :func:`search_policy`.

    Returns:
        The outcome of the search whose policy was kept, with the work of all searches.
    """
    network = loss.actor_network
    successes = promise.predicted(loss, initial)
    best = result, successes, copy.deepcopy(network.state_dict())
    searches = _searches(loss, initial, settings, make_policy, restarts, report)
    while best[1].least < promise.aim and (found := next(searches, None)) is not None:
        successes = promise.predicted(loss, initial)
        merit = successes.successes, -found.loss
        work, kept = found.with_work_of(best[0]), best[0].with_work_of(found)
        if merit > (best[1].successes, -best[0].loss):
            best = work, successes, copy.deepcopy(network.state_dict())
        else:
            best = kept, *best[1:]
    network.load_state_dict(best[2])
    return best[0]


def _searches(
    loss: TrajectoryLoss,
    initial: Gaussian,
    settings: SearchSettings,
    make_policy: Callable[[], RBFPolicy],
    restarts: int,
    report: Report,
) -> Iterator[SearchResult]:
    """Outcomes of one search after the other, each of which leaves its policy in the loss."""
    if isinstance(loss, TrajectoryKLLoss):
        yield steady_policy(loss, initial, settings, report)
    for _ in range(restarts):
        loss.actor_network.load_state_dict(make_policy().state_dict())
        found = search_policy(loss, initial, settings, report, random=True)
        yield found
        if found.complete and isinstance(loss, TrajectoryKLLoss):
            yield steady_policy(loss, initial, settings, report)


def steady_policy(
    loss: TrajectoryKLLoss,
    initial: Gaussian,
    settings: SearchSettings,
    report: Report = lambda stage, loss: None,
) -> SearchResult:
    r"""Minimise the cross-entropy relative to the demonstrations over the whole horizon.

    .. math:: \sum_t \mathbb E_{p(x_t^\pi)}[-\log p(x_t^{\exp})]

    The policy of least KL to the demonstrations varies as much as they do: where their own spread
    is beyond what counts as a success, it fails as often as they would. This search narrows the
    prediction towards what is most likely under the demonstrations. It takes
    ``settings.final_iterations`` from the policy that a search of the KL left.

    Args:
        loss, initial, settings, report: as of :func:`search_policy`.

    Returns:
        The outcome, whose ``loss`` is the KL, as that of every search.

    Raises:
        PredictionError: the prediction fails at the policy that was given.
    """
    runs = SearchRuns(loss, initial, settings, report)
    iterations = settings.final_iterations
    runs.run("cross-entropy", loss.cross_entropy_per_step, loss.horizon, iterations)
    return runs.result(loss.horizon)
