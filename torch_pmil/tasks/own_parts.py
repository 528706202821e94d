"""Parts of the method that are a user's own: optimiser, policy and forward model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from torch_pmil.control.module_policy import MakePolicy, check_maker
from torch_pmil.gp.lbfgs import MakeOptimizer, check_optimizer
from torch_pmil.model.own_dynamics import check_own_model
from torch_pmil.tasks.task import Task

T = TypeVar("T", bound=Task)


def with_own(task: T, optimizer: MakeOptimizer | None, policy: MakePolicy | None, model: Any) -> T:
    """The same task with parts of the method that are a user's own, where they are not None.

    Raises TypeError if one is of another kind, or the optimiser does not fit the search.
    """
    parts: dict[str, Any] = {}
    if optimizer is not None:
        check_optimizer(optimizer)
        parts["optimizer"] = optimizer
    if policy is not None:
        check_maker(policy)
        parts["make_policy"] = policy
    if model is not None:
        check_own_model(model)
        parts["own_model"] = model
    return replace(task, method=replace(task.method, **parts)) if parts else task
