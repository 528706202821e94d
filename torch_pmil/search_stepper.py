"""The optimisation step of Algorithm 1, as TorchRL's trainer takes it."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.trainers import OptimizationStepper, Trainer

from torch_pmil.gaussian import Gaussian
from torch_pmil.policy import RBFPolicy
from torch_pmil.policy_search import SearchResult, SearchSettings, search_policy
from torch_pmil.trajectory_loss import TrajectoryLoss

STATE = ("_longest", "_least", "_stalled")


class PolicySearchStepper(OptimizationStepper):
    """The optimisation step of Algorithm 1: a whole policy search (Eq. 22) on the trainer's loss.

    A search starts from the policy that the last one left. Some searches in a row without progress (no more steps trusted, and not
    a twentieth less loss than the best before) sit in a local optimum: others begin at once from random policies, and the best
    one is kept.

    Args:
        settings: budget and horizon of a search, and when and how often it begins anew.
        make_policy: a new random policy of the same shape.
        report: called with the name and the loss of each run of L-BFGS.
    """

    def __init__(
        self,
        settings: SearchSettings,
        make_policy: Callable[[], RBFPolicy],
        report: Callable[[str, float], None],
    ) -> None:
        self.settings, self.make_policy, self.report = settings, make_policy, report
        self.result: SearchResult | None = None
        self.restarted = False
        self._longest, self._least, self._stalled = 0, math.inf, 0

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Search from the belief p(x_0) in ``sub_batch``; the policy of the loss is changed in place."""
        loss = trainer.loss_module
        initial = Gaussian(sub_batch["observation", "mean"], sub_batch["observation", "var"])
        self.result = search_policy(loss, initial, self.settings, self.report, random=self._least == math.inf)
        self._stalled = 0 if self.result.complete or self._progressed() else self._stalled + 1
        self.restarted = self._stalled == self.settings.patience
        if self.restarted:
            for _ in range(self.settings.restarts):
                self._search_anew(loss, initial)
            self._stalled = 0
        self._longest, self._least = max(self._longest, self.result.horizon), min(self._least, self.result.kl)
        return TensorDict({loss.out_keys[0]: torch.tensor(self.result.kl, dtype=torch.float64)})

    def state_dict(self) -> dict[str, object]:
        """What the next search depends on, besides policy and model."""
        return {name: getattr(self, name) for name in STATE}

    def load_state_dict(self, state_dict: dict[str, object]) -> None:
        """Restore what :meth:`state_dict` gave."""
        for name in STATE:
            setattr(self, name, state_dict[name])

    def _search_anew(self, loss: TrajectoryLoss, initial: Gaussian) -> None:
        first = copy.deepcopy(loss.actor_network.state_dict())
        loss.actor_network.load_state_dict(self.make_policy().state_dict())
        second = search_policy(loss, initial, self.settings, self.report, random=True)
        better = second if second.kl < self.result.kl else self.result
        if better is not second:
            loss.actor_network.load_state_dict(first)
        self.result = replace(
            better,
            seconds=self.result.seconds + second.seconds,
            evaluations=self.result.evaluations + second.evaluations,
            failures=self.result.failures + second.failures,
        )

    def _progressed(self) -> bool:
        return self.result.horizon > self._longest or self.result.kl < 0.95 * self._least
