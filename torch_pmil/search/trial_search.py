"""What a trial searches: from which starts, in which order, and which policy is kept (Eq. 22)."""

from __future__ import annotations

import copy
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import MakeOptimizer
from torch_pmil.search.expected_cost import ExpectedCost
from torch_pmil.search.losses import TrajectoryKLLoss
from torch_pmil.search.policy_search import (
    Report,
    SearchResult,
    SearchRuns,
    SearchSettings,
    refit_policy,
    search_policy,
)
from torch_pmil.search.promise import Promise
from torch_pmil.search.sample_search import (
    PROMISING,
    SampleSearches,
    add_search_on_samples,
    expected_cost,
)
from torch_pmil.search.success_search import search_for_success
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.seeds import draw_seed

# trust of a search that comes no further, and its last iterations, in those of the settings
BOLDER = 4.0
PROGRESS = 0.8  # a search should bring the loss below this fraction of the smallest so far
ALONE = 500  # steps of a search on samples that settings do not ask for
FAR_OFF = 0.1  # that of the last policy, below which samples are searched from a random one


class TrialSearch:
    """The policy searches of the trials of one run.

    A trial searches from the policy that the last one left. If that neither matches the whole
    horizon nor brings the loss well below the smallest so far, it searches from the refitted policy
    too (:func:`refit_policy`), then with more trust and patience, and then from
    ``settings.restarts`` random policies. The best is kept. After a rollout that failed, a match of
    the whole horizon is not enough: it may be that of a poor optimum.

    A policy that matches the whole horizon, but is predicted to fail from too many starts, is
    searched on (:func:`search_for_success`).

    With ``settings.sample_steps`` none of this is needed. The whole horizon is first searched on
    samples (:func:`search_on_samples`): from the last policy, or from a random one while that is
    predicted to fail from nearly all starts. Such a policy may be at its limits all the time, where
    gradients vanish. The loss is searched from there only if success is then predicted from half
    the starts: until then the trajectories part, and their moments say little. The second policy
    is kept if it keeps the promise, else the one of less expected cost.

    The search on samples is the whole search if policy, model or cost has no moments in closed
    form, or if the loss is a cost and the start is wider than what is trusted. It is repeated from
    a random policy if it brought neither a promising success rate nor progress. A search of a cost
    by moments is followed by a search on samples, in place of the search for success. The best of
    these policies is kept (:class:`SampleSearches`).

    Args:
        settings, report, optimizer: as for :func:`search_policy`.
        make_policy: returns a new random policy of the same shape.
        generator: source of the states of :func:`refit_policy`, and of all samples.
        promise: what the policy must keep; None if no success is predicted.
    """

    result: SearchResult  # of the last trial
    refitted = False  # whether it searched from a refitted policy too

    def __init__(
        self,
        settings: SearchSettings,
        make_policy: Callable[[], AnyPolicy],
        generator: torch.Generator,
        promise: Promise | None = None,
        report: Report = lambda stage, loss: None,
        optimizer: MakeOptimizer = torch.optim.LBFGS,
    ) -> None:
        self.settings, self.make_policy, self.generator = settings, make_policy, generator
        self.promise, self.report, self.optimizer = promise, report, optimizer
        self._least = math.inf

    def run(self, loss: TrajectoryLoss, initial: Gaussian, succeeded: bool | None) -> SearchResult:
        """Search the policy of one trial, as :func:`search_policy`.

        ``succeeded`` says whether the last rollout was a success; None before the first.
        """
        settings, report, optimizer = self.settings, self.report, self.optimizer
        self.refitted = False
        search = partial(
            search_policy, loss, initial, settings=settings, report=report, optimizer=optimizer
        )
        if not (loss.has_moments and loss.trusts_start(initial, settings.trust_threshold)):
            return self._on_samples_alone(loss, initial)
        if settings.sample_steps:
            return self._begun_on_samples(loss, initial, search)
        self.result = search(random=self._least == math.inf)
        self.refitted = not self._enough(succeeded)
        if self.refitted:
            new = self.make_policy()
            refitted = refit_policy(loss, initial, new, settings, self.generator)
            self._keep_better(loss, refitted, search)
        if not (self.result.complete or self._enough(succeeded)):
            bolder = replace(
                settings,
                trust_threshold=BOLDER * settings.trust_threshold,
                final_iterations=round(BOLDER * settings.final_iterations),
            )
            found = copy.deepcopy(loss.actor_network)
            if self._keep_better(loss, found, partial(search, settings=bolder)):
                settings = bolder
        for _ in range(settings.restarts):
            if not self._enough(succeeded):
                self._keep_better(loss, self.make_policy(), partial(search, random=True))
        self._least = min(self._least, self.result.loss)
        if self.promise is None or not self.result.complete:
            return self.result
        if isinstance(loss, ExpectedCost):
            return self._ended_on_samples(loss, initial)
        if isinstance(loss, TrajectoryKLLoss):
            known = loss, initial, self.promise, settings, self.result
            self.result = search_for_success(*known, report, optimizer)
        return self.result

    def begin_anew(self) -> None:
        """Forget the smallest loss so far, since another objective is minimised from now on.

        It becomes the largest float and not infinity, which would mark the policy as one that no
        search has seen.
        """
        self._least = sys.float_info.max

    def _begun_on_samples(
        self, loss: TrajectoryLoss, initial: Gaussian, search: Callable[[], SearchResult]
    ) -> SearchResult:
        """Search on samples, then the loss if they promise much, and keep the better policy."""
        if self._rate(loss, initial) < FAR_OFF:
            loss.actor_network.load_state_dict(self.make_policy().state_dict())
        runs = self._runs(loss, initial)
        add_search_on_samples(runs, self.settings.sample_steps, self.generator)
        self.result = first = runs.result(loss.horizon)
        if self._rate(loss, initial) < PROMISING:
            return first
        judge = partial(expected_cost, loss, initial, draw_seed(self.generator))
        expected, found = judge(), copy.deepcopy(loss.actor_network.state_dict())
        second = search()
        better = self._keeps_promise(loss, initial) or judge() < expected
        return self._kept(loss, (first, found), second, better)

    def _on_samples_alone(self, loss: TrajectoryLoss, initial: Gaussian) -> SearchResult:
        """Search on samples, from a random policy too where the last one led to little."""
        searches = self._sample_searches(loss, initial)
        found = searches.search()
        if found.rate < PROMISING and not self._progresses(found.cost):
            loss.actor_network.load_state_dict(self.make_policy().state_dict())
            found = min(found, searches.search(), key=lambda each: each.cost)
        self._least = min(self._least, found.cost)
        self.result = searches.best()
        return self.result

    def _ended_on_samples(self, loss: TrajectoryLoss, initial: Gaussian) -> SearchResult:
        """Search on samples too if the promise is not kept, from the policy that moments found."""
        if not self._keeps_promise(loss, initial):
            searches = self._sample_searches(loss, initial)
            searches.search()
            self.result = searches.best().with_work_of(self.result)
        return self.result

    def _sample_searches(self, loss: TrajectoryLoss, initial: Gaussian) -> SampleSearches:
        steps, rate = self.settings.sample_steps or ALONE, partial(self._rate, loss, initial)
        return SampleSearches(self._runs(loss, initial), steps, self.generator, rate)

    def _kept(
        self,
        loss: TrajectoryLoss,
        before: tuple[SearchResult, dict[str, Tensor]],
        second: SearchResult,
        better: bool,
    ) -> SearchResult:
        """The second outcome if it is better, else the one before with its parameters."""
        first, parameters = before
        if better:
            self.result = second.with_work_of(first)
        else:
            loss.actor_network.load_state_dict(parameters)
            self.result = first.with_work_of(second)
        return self.result

    def _rate(self, loss: TrajectoryLoss, initial: Gaussian) -> float:
        """Predicted success rate of the present policy; 1 if no success is predicted."""
        return 1.0 if self.promise is None else self.promise.predicted(loss, initial).rate

    def _keeps_promise(self, loss: TrajectoryLoss, initial: Gaussian) -> bool:
        promise = self.promise
        return promise is not None and promise.predicted(loss, initial).least >= promise.aim

    def _runs(self, loss: TrajectoryLoss, initial: Gaussian) -> SearchRuns:
        return SearchRuns(loss, initial, self.settings, self.report, self.optimizer)

    def _enough(self, succeeded: bool | None) -> bool:
        """Whether the best policy so far makes other starts needless."""
        matched = self.result.complete and succeeded is not False
        return matched or self._progresses(self.result.loss)

    def _progresses(self, loss: float) -> bool:
        """Whether a loss, which may be negative, is well below the smallest so far."""
        return loss < self._least * (PROGRESS if self._least > 0 else 2 - PROGRESS)

    def _keep_better(
        self, loss: TrajectoryLoss, start: AnyPolicy, search: Callable[[], SearchResult]
    ) -> bool:
        """Search from another start, keep the better of the two policies, and say if it is new."""
        found = self.result, copy.deepcopy(loss.actor_network.state_dict())
        loss.actor_network.load_state_dict(start.state_dict())
        second = search()
        better = second.loss < self.result.loss
        self._kept(loss, found, second, better)
        return better

    def state_dict(self) -> dict[str, Any]:
        """State on which the next search depends, besides policy and model."""
        return {"least": self._least}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        self._least = state_dict["least"]
