"""A robot that an operator attends, and whose rollouts may end early, in simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from tensordict import TensorDictBase

from tests.helpers.short_run import short_experiment
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.operator import RobotError, RolloutDiscarded, RunStopped
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.task import Task

KEYS: dict[str, Exception] = {
    "d": RolloutDiscarded("the last rollout is discarded"),
    "q": RunStopped("the operator ended the run"),
    "off": RobotError("the robot does not answer"),
}


@dataclass
class Operator:
    """Presses these keys, one before each rollout, and then lets all rollouts run."""

    keys: Sequence[str] = ()
    asked: int = 0

    def __call__(self) -> None:
        self.asked += 1
        key = self.keys[self.asked - 1] if self.asked <= len(self.keys) else ""
        if key:
            raise KEYS[key]


class AttendedPendulum(DoublePendulumEnv):
    """A double pendulum with an operator.

    Args:
        operator: called before each rollout.
        failing: numbers of rollouts, from 1, whose reading fails, with the step of that.
        given: what :class:`DoublePendulumEnv` takes.
    """

    physical = True

    def __init__(
        self, operator: Callable[[], None], failing: dict[int, int] | None = None, **given: Any
    ) -> None:
        super().__init__(**given)
        self.operator, self.failing, self.rollouts, self.steps = operator, failing or {}, 0, 0

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        self.operator()
        self.rollouts, self.steps = self.rollouts + 1, 0
        return super()._reset(tensordict, **kwargs)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        sent = tensordict["action"].clamp(-1, 1)
        step = super()._step(tensordict.clone().set("action", sent))
        self.steps += 1
        failed = self.failing.get(self.rollouts) == self.steps
        if failed:
            self.cut_short = f"no reading in step {self.steps}"
            step["done"] = torch.ones_like(step["done"])
            step["observation"] = torch.full_like(step["observation"], torch.nan)
        step["measured"], step["sent"] = ~torch.full_like(step["done"], failed), sent
        return step


@dataclass
class Attended:
    """Makes the environment of an attended run, and keeps the last one.

    Args:
        operator: attends it.
        failing: of :class:`AttendedPendulum`.
        guard: of the environment; None for none.
    """

    operator: Operator = field(default_factory=Operator)
    failing: dict[int, int] | None = None
    guard: Callable[[torch.Tensor], str] | None = None

    def __call__(self, seed: int | None = None, **given: Any) -> AttendedPendulum:
        env = AttendedPendulum(self.operator, self.failing, seed=seed, **given)
        env.guard = self.guard
        return env

    def experiment(self, **changes: Any) -> Task:
        """The first steps of the double pendulum, judged by the robot's own rollouts."""
        search = SearchSettings(1, 1, 1, first_horizon=1.0, trust_threshold=1e-9)
        task = short_experiment(search=search, evaluated=False, **changes)
        return replace(task, make_env=self, draws=False)
