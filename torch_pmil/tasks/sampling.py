"""How a robot is sampled: the length of a step, and how much of the past its state holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from torch_pmil.envs.held_actions import HeldActionsEnv
from torch_pmil.envs.rollouts import OfStates, of_states
from torch_pmil.tasks.deviation import Deviation
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history


@dataclass(frozen=True)
class Sampling:
    """How model and policy see and move a robot.

    Args:
        held: control periods of the robot for which an action is held.
        past_entries, past_actions, positions_only: what the state holds of the past, see
            :func:`~torch_pmil.tasks.with_history.with_history`.
    """

    held: int = 1
    past_entries: int = 0
    past_actions: int = 0
    positions_only: bool = False

    @property
    def past(self) -> dict[str, Any]:
        """What the state holds of the past, if it holds any."""
        names = ("past_actions", "past_entries", "positions_only")
        return {name: value for name in names if (value := getattr(self, name))}

    def of(self, task: Task) -> Task:
        """The task of a robot that is sampled so."""
        sampled = at_step(replace(task, samplings=()), self.held)
        return with_history(sampled, **self.past) if self.past else sampled

    def described(self, period: float) -> str:
        """The step, for a robot with this control period (s), and the past.

        Example:
            >>> Sampling(held=2, past_actions=1).described(0.05)
            'steps of 0.1 s, past_actions=1'
        """
        past = [f"{name}={value}" for name, value in self.past.items()]
        return ", ".join([f"steps of {self.held * period:g} s", *past])


def at_step(task: Task, held: int) -> Task:
    """The same task with each action held for so many control periods of the robot.

    Demonstrations are those of every ``held``-th period. What is left of the last one is dropped.

    Raises:
        ValueError: the task has an error of its own or a history, or fewer than ``held`` periods.
    """
    if held == 1:
        return task
    error = task.error.of_states if isinstance(task.error, OfStates) else None
    if task.history is not None or not isinstance(error, Deviation) or task.horizon < held:
        raise ValueError(
            f"{task.name} must have {held} control periods at least, no history, and no error of "
            f"its own, got {task.horizon} periods, {task.history} and {task.error!r:.80}"
        )
    shown, count = task.demonstrations, len(task.demonstrations.positions)
    kept = replace(shown, positions=shown.positions[:, ::held], time_step=held * shown.time_step)
    states = task.demonstrated_states.unflatten(0, (count, -1))[:, ::held].flatten(0, 1)
    return replace(
        task,
        make_env=partial(HeldActionsEnv, task.make_env, held),
        demonstrations=kept,
        demonstrated_states=states,
        error=of_states(error.every(held)),
        held=held,
    )
