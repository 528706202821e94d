"""The task of a robot that is sampled in another way."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from torch_pmil.envs.held_actions import HeldActionsEnv
from torch_pmil.envs.rollouts import OfStates, of_states
from torch_pmil.tasks.deviation import Deviation
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history


def resampled(task: Task, sampling: Sampling) -> Task:
    """The same task with this step and past.

    Raises:
        ValueError: as :func:`at_step`.
    """
    sampled = at_step(replace(task, samplings=()), sampling.held)
    return with_history(sampled, **sampling.past) if sampling.past else sampled


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
