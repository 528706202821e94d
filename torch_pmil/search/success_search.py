"""The search that continues until the predicted success rate reaches the promised one."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import MakeOptimizer, NotFiniteError
from torch_pmil.model.rollout import PredictionError
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import Report, SearchResult, SearchRuns, SearchSettings
from torch_pmil.search.promise import PredictedSuccess, Promise

STEADYINGS = 6  # of one policy, while it gets no worse
WIDER = 0.2  # by which the standard deviation of the start grows from one to the next
CHANCE = 0.02  # difference of predicted success rates that says little
HOPELESS = 0.01  # predicted success rate of a policy that steadying does not save


@dataclass(frozen=True, eq=False)
class _Found:
    """A policy that a search found, and its predicted success."""

    result: SearchResult
    predicted: PredictedSuccess
    parameters: dict[str, Tensor]

    @property
    def merit(self) -> tuple[float, float]:
        return self.predicted.rate, -self.result.loss


def search_for_success(
    loss: TrajectoryKLLoss,
    initial: Gaussian,
    promise: Promise,
    settings: SearchSettings,
    result: SearchResult,
    report: Report = lambda stage, loss: None,
    optimizer: MakeOptimizer = torch.optim.LBFGS,
) -> SearchResult:
    """Search on until :attr:`PredictedSuccess.least` of the policy reaches :attr:`Promise.aim`.

    The policy is steadied (:func:`steady_policy`) again and again, each time for starts that vary
    more: moments hide the few that go elsewhere, which are the outer ones. It goes on while the
    policy gets no worse and is not hopeless. The policy with the highest predicted rate is kept;
    among equals, the one with the least loss.

    Args:
        loss, initial, settings, report, optimizer: as for
            :func:`~torch_pmil.search.policy_search.search_policy`.
        promise: what the policy must keep.
        result: outcome of the search that found the policy, which matches the whole horizon.

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

    needed, worse = judge(result), False
    while needed and not worse and len(found) <= STEADYINGS:
        wider = 1 + WIDER * (len(found) - 1)
        try:
            needed = judge(steady_policy(loss, initial, settings, report, optimizer, wider))
        except (PredictionError, NotFiniteError):  # so wide that nothing can be predicted
            break
        most = max(each.predicted.rate for each in found)
        worse = found[-1].predicted.rate < max(most - CHANCE, HOPELESS)
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
    optimizer: MakeOptimizer = torch.optim.LBFGS,
    wider: float = 1.0,
) -> SearchResult:
    r"""Minimise the cross-entropy relative to the demonstrations over the whole horizon.

    .. math:: \sum_t \mathbb E_{p(x_t^\pi)}[-\log p(x_t^{\exp})]

    The policy of least KL to the demonstrations varies as much as they do, and fails as often as
    they would. This search of ``settings.final_iterations`` narrows the prediction towards what is
    most likely under the demonstrations. The ``loss`` of its outcome is the KL all the same.
    Arguments and errors are those of :func:`~torch_pmil.search.policy_search.search_policy`.
    ``wider`` is by how much more starts vary in this search than in the outcome.
    """
    start = Gaussian(initial.mean, wider**2 * initial.cov)
    runs, horizon = SearchRuns(loss, start, settings, report, optimizer), loss.horizon
    runs.run("cross-entropy", loss.cross_entropy_per_step, horizon, settings.final_iterations)
    runs.initial = initial
    return runs.result(horizon)
