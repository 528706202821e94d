"""Guards of a task end a robot's motion, beside its own, and never another task's motion."""

from __future__ import annotations

import torch

from tests.helpers.short_run import short_experiment
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.guards import set_guards


def saying(line: str, where: float) -> object:
    return lambda states: line if states[..., 0].amax() > where else ""


def test_every_guard_ends_the_motion_and_those_of_an_earlier_task_are_gone() -> None:
    env = DoublePendulumEnv()
    env.guard = saying("own", 3.0)
    for _ in range(2):
        set_guards(env, saying("box", 2.0), None, saying("fall", 1.0))
    at = [torch.tensor([value, 0.0]) for value in (0.5, 1.5, 2.5, 3.5)]
    assert [env.guard(state) for state in at] == ["", "fall", "box", "own"]
    set_guards(env, None)
    assert [env.guard(state) for state in at] == ["", "", "", "own"]


def test_robot_that_two_tasks_share_keeps_no_limits_of_the_first() -> None:
    env = DoublePendulumEnv()
    limited = short_experiment(make_env=lambda **given: env, box={"q1": (3.0, 3.3)})
    assert limited.robot(0).guard(torch.zeros(4).double()).startswith("q1 = 0")
    free = short_experiment(make_env=lambda **given: env)
    assert free.robot(0).guard is None
    problem = limited.problem(0)
    assert problem.guards[0] is not None and problem.guards[1] is not None
