"""PILCO, the baseline of Section 5.1.1: a cost in place of the demonstrations."""

from __future__ import annotations

from dataclasses import fields, replace

import torch

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.search.target_costs import SaturatingCost
from torch_pmil.tasks.cost_task import SEARCH, CostTask
from torch_pmil.tasks.double_pendulum import UPRIGHT, double_pendulum
from torch_pmil.tasks.method import ModelSettings
from torch_pmil.tasks.task import Task

COST_WIDTH = 2.0  # m, Eq. 28
VELOCITY_STD = 3.0  # rad/s


def with_cost(task: Task, name: str, cost: SaturatingCost, velocity_std: float) -> CostTask:
    """The robot, the start, the measure of success and the policy class of a task, with a cost."""
    left = {"name", "demonstrations", "demonstrated_states", "noise_std", "method", "samplings"}
    same = {each.name: getattr(task, each.name) for each in fields(Task) if each.name not in left}
    return CostTask(
        **same,
        name=name,
        cost=cost,
        steps=task.horizon,
        control_period=task.time_step,
        # of velocities alone PILCO learns later, and with some seeds not within twelve trials
        method=replace(task.method, model=ModelSettings(), search=SEARCH),
        centre_std=torch.full((task.space.dim,), velocity_std, dtype=torch.float64),
    )


def double_pendulum_pilco(demonstrations: Demonstrations | None = None) -> CostTask:
    """The swing-up of Section 5.1 by PILCO; arguments and errors as in :func:`double_pendulum`."""
    task = double_pendulum(demonstrations)
    target = dict(zip(task.space.match_space.names, UPRIGHT, strict=True))
    cost = SaturatingCost(target=target, width=COST_WIDTH)
    return with_cost(task, "double_pendulum_pilco", cost, VELOCITY_STD)
