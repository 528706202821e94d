"""Search on where a policy matches the demonstrations, and yet fails from too many starts."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from torch import Tensor

from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import (
    SearchResult,
    SearchRuns,
    SearchSettings,
    search_policy,
)
from torch_pmil.search.promise import PredictedSuccess, Promise
from torch_pmil.search.trajectory_loss import TrajectoryLoss

Report = Callable[[str, float], None]

STEADYINGS = 8  # of one policy, while it gets no worse


@dataclass(frozen=True, eq=False)
class _Found:
    """A policy that a search left, and what is predicted of it."""

    result: SearchResult
    predicted: PredictedSuccess
    parameters: dict[str, Tensor]

    @property
    def merit(self) -> tuple[float, float]:
        return self.predicted.rate, -self.result.loss


def search_for_success(
    loss: TrajectoryLoss,
    initial: Gaussian,
    promise: Promise,
    settings: SearchSettings,
    result: SearchResult,
    policies: Iterable[RBFPolicy] = (),
    report: Report = lambda stage, loss: None,
) -> SearchResult:
    """Search on until the predicted success rate of the policy is :attr:`Promise.aim`.

    The policy is steadied first (:func:`steady_policy`), if the loss is a KL, again and again while
    it gets no worse. Then others are searched from random policies, and steadied too. The policy
    with the highest predicted rate is kept, of several alike the one of least loss.

    Args:
        loss: objective with the policy (changed in place) and the model.
        initial: p(x_0).
        promise: what the policy shall keep.
        settings: budget and horizon of the searches.
        result: of the search that found the policy, which matches the whole horizon.
        policies: random policies of the same shape, of which no more are taken than are needed.
        report: as of :func:`search_policy`.

    Returns:
        The outcome of the search whose policy was kept, with the work of all searches.
    """
    network = loss.actor_network
    found: list[_Found] = []

    def judge(result: SearchResult) -> bool:
        """Note the policy that was found; return whether a better one is needed."""
        predicted = promise.predicted(loss, initial)
        found.append(_Found(result, predicted, copy.deepcopy(network.state_dict())))
        return predicted.least < promise.aim

    def steady() -> bool:
        """Steady the last policy; return whether a better one is needed."""
        if not isinstance(loss, TrajectoryKLLoss) or not found[-1].result.complete:
            return True
        for _ in range(STEADYINGS):
            if not judge(steady_policy(loss, initial, settings, report)):
                return False
            if found[-1].predicted.rate < found[-2].predicted.rate:
                break
        return True

    needed, others = judge(result) and steady(), iter(policies)
    while needed and (policy := next(others, None)) is not None:
        network.load_state_dict(policy.state_dict())
        again = search_policy(loss, initial, settings, report, random=True)
        needed = judge(again) and steady()
    best = max(found, key=lambda each: each.merit)
    network.load_state_dict(best.parameters)
    kept = best.result
    for other in found:
        kept = kept if other is best else kept.with_work_of(other.result)
    return kept


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
