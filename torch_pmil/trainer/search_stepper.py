"""The optimisation step of Algorithm 1 for TorchRL's trainer."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.trainers import OptimizationStepper, Trainer

from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.policy_search import (
    SearchResult,
    SearchSettings,
    refit_policy,
    search_policy,
)
from torch_pmil.search.promise import Promise
from torch_pmil.search.success_search import search_for_success
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.trainer.plan_tracking import PlanTracking

RESTARTS = 6  # of the searches for success of a run
PROGRESS = 0.8  # a search should come to this fraction of the least loss so far


class PolicySearchStepper(OptimizationStepper):
    """The optimisation step of Algorithm 1: a whole policy search (Eq. 22) on the trainer's loss.

    A search starts from the policy that the last one left. Where it neither matches the whole
    horizon nor brings the loss well below the least so far, a second search starts from the
    refitted policy (:func:`refit_policy`). Where that brings no more, others start from random
    policies if the settings say so. The best one is kept. After a rollout that failed it does not
    suffice to match the whole horizon: an optimum far above others may do so too.

    With ``tracking`` each step makes another search, from a policy that follows a plan on the mean
    of the model, and the better one is kept.

    A policy that then matches the whole horizon, and yet is predicted to fail from too many starts,
    is searched on (:func:`search_for_success`), from random policies only after a rollout that
    succeeded: before, what is predicted to fail may be what the model does not know yet.

    Args:
        settings: budget and horizon of a search.
        promise: what the policy shall keep; None for no prediction of it.
        make_policy: returns a new random policy of the same shape.
        generator: source of the random states of :func:`refit_policy`.
        report: called with the name and the loss of each run of L-BFGS.
        tracking: how to plan on the mean of the model; None for no such start.
    """

    result: SearchResult  # outcome of the last step

    def __init__(
        self,
        settings: SearchSettings,
        promise: Promise | None,
        make_policy: Callable[[], RBFPolicy],
        generator: torch.Generator,
        report: Callable[[str, float], None],
        tracking: PlanTracking | None = None,
    ) -> None:
        self.settings, self.promise, self.make_policy = settings, promise, make_policy
        self.generator, self.report = generator, report
        self.refitted, self.tracking = False, tracking
        guess = None if tracking is None else torch.from_numpy(tracking.first_guess)
        self._planned = torch.empty(0) if guess is None else guess  # actions of the last plan
        self._least, self._restarts_left = math.inf, RESTARTS

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Search from the belief p(x_0) in ``sub_batch``.

        The policy of the loss is changed in place.
        """
        loss = trainer.loss_module
        initial = Gaussian(sub_batch["observation", "mean"], sub_batch["observation", "var"])

        def refit() -> None:
            refit_policy(loss, initial, self.make_policy(), self.settings, self.generator)

        def restart() -> None:
            loss.actor_network.load_state_dict(self.make_policy().state_dict())

        first = self._least == math.inf
        self.result = search_policy(loss, initial, self.settings, self.report, random=first)
        if self.tracking is not None:
            self._search_also(loss, initial, partial(self._plan, loss, self.tracking))
        failed = not all(trial.own_success for trial in trainer.trials[-1:])
        self.refitted = not self._enough(failed)
        if self.refitted:
            self._search_also(loss, initial, refit)
        for _ in range(self.settings.restarts):
            if not self._enough(failed):
                self._search_also(loss, initial, restart, random=True)
        self._least = min(self._least, self.result.loss)
        succeeded = any(trial.own_success for trial in trainer.trials[-1:])
        if self.promise is not None and self.result.complete:
            self.result = search_for_success(
                loss,
                initial,
                self.promise,
                self.settings,
                self.result,
                self._random_policies() if succeeded else (),
                self.report,
            )
        return TensorDict({loss.out_keys[0]: torch.tensor(self.result.loss, dtype=torch.float64)})

    def state_dict(self) -> dict[str, Any]:
        """State on which the next search depends, besides policy and model."""
        return {
            "least": self._least,
            "restarts_left": self._restarts_left,
            "planned": self._planned,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` gave."""
        self._least, self._restarts_left = state_dict["least"], state_dict["restarts_left"]
        self._planned = state_dict["planned"]

    def _plan(self, loss: TrajectoryLoss, tracking: PlanTracking) -> None:
        """Let the policy follow a plan on the mean of the model, from the last plan on or anew."""
        last, policy = self._planned.numpy(), self.make_policy()
        tracked = tracking.plan(loss.dynamics, last)
        tracking.fit_policy(policy, tracked, self.generator)
        loss.actor_network.load_state_dict(policy.state_dict())
        self._planned = torch.from_numpy(tracked.plan.actions)

    def _random_policies(self) -> Iterator[RBFPolicy]:
        """New policies, as many as this run may still begin searches for success with."""
        while self._restarts_left:
            self._restarts_left -= 1
            yield self.make_policy()

    def _enough(self, failed: bool) -> bool:
        progress = self.result.loss < PROGRESS * self._least
        return progress or (self.result.complete and not failed)

    def _search_also(
        self,
        loss: TrajectoryLoss,
        initial: Gaussian,
        begin: Callable[[], object],
        random: bool = False,
    ) -> None:
        found = copy.deepcopy(loss.actor_network.state_dict())
        begin()
        second = search_policy(loss, initial, self.settings, self.report, random=random)
        if second.loss < self.result.loss:
            self.result = second.with_work_of(self.result)
        else:
            loss.actor_network.load_state_dict(found)
            self.result = self.result.with_work_of(second)
