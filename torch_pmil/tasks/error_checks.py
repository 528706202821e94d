"""Whether a user's own error, success or cost judges motions, tried before the robot moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor

from torch_pmil.envs.rollouts import OfStates, check_results, fault_of_results, rollout_of
from torch_pmil.search.sampled_cost import CostFunction
from torch_pmil.search.target_costs import FunctionCost
from torch_pmil.tasks.task import Task

MOTIONS = 3


def check_error(task: Task) -> None:
    """Judge a few motions, and a single one, that stay at the mean of the start.

    An error of rollouts that reads what only the environment knows is left to the first rollout.

    Raises:
        TypeError: the error is one of states, where it must be one of rollouts.
        ValueError: it fails for such states, or does not return a real number for each motion; or a
            cost that is a function fails.
    """
    still = task.initial.mean.repeat(MOTIONS, task.horizon + 1, 1)
    cost = getattr(task, "cost", None)
    if isinstance(cost, FunctionCost):
        _check_cost(cost.function, still, task.actions.middle)
    for states in (still, still[0]):
        if task.promised is not None:
            _check_of_states(task.promised.error, states)
        if not isinstance(task.error, OfStates):
            _check_of_rollouts(task, states)


def _check_cost(cost: CostFunction, states: Tensor, action: Tensor) -> None:
    actions = action.expand(*states[:, 1:].shape[:-1], -1)
    try:
        cost(states[:, 1:], actions)
    except Exception as problem:  # of any kind: the function is a user's
        raise ValueError(
            "cost must be a function of states (*batch, T, D) and actions (*batch, T, F), got "
            f"{problem!r:.120}"
        ) from problem


def _check_of_states(error: Callable[[Tensor], Tensor], states: Tensor) -> None:
    try:
        errors = error(states)
    except (IndexError, RuntimeError) as problem:
        raise ValueError(
            "error and success must judge motions by states (*batch, T + 1, D), got "
            f"{problem!r:.120} for states {tuple(states.shape)}"
        ) from problem
    check_results("error", errors, states.shape[:-2])


def _check_of_rollouts(task: Task, states: Tensor) -> None:
    rollouts = rollout_of(states)
    rollouts["action"] = task.actions.middle.expand(*rollouts.shape, -1)
    batch = tuple(states.shape[:-2])
    fault = _fault(task.error, rollouts, batch)
    if fault != "" and _fault(task.error, states, batch) == "":
        raise TypeError(
            "error must be a function of rollouts, got one of states: give error=of_states(...), "
            "of torch_pmil.envs.rollouts"
        )
    if fault:
        raise ValueError(fault)


def _fault(error: Callable[[Any], Tensor], motions: Any, batch: tuple[int, ...]) -> str | None:
    """What is wrong with the errors of motions (*batch), "" if nothing; None if there are none."""
    try:
        errors = error(motions)
    except Exception:  # of any kind: the function is a user's, and may be of other motions
        return None
    return fault_of_results("error", errors, batch)
