"""A motion ends where its environment terminates, unless demonstrations show that."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from torch_pmil import PMIL
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.runs.training import make_trainer
from torch_pmil.tasks.task import Task

PUSH, STEPS = 0.1, 20


class Sliding(gymnasium.Env):
    """A point that slides on and on, which ends its episode beyond a place."""

    def __init__(self, ends_at: float) -> None:
        self.ends_at, self.dt = ends_at, PUSH
        self.observation_space = Box(-np.inf, np.inf, (1,), np.float64)
        self.action_space = Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.x = 0.01 * self.np_random.standard_normal(1)
        return self.x.copy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        self.x = self.x + PUSH + 0.01 * action
        return self.x.copy(), 0.0, bool(self.x[0] > self.ends_at), False, {}


def task(ends_at: float, shown_until: float, **said: object) -> Task:
    way = shown_until * torch.linspace(0, 1, STEPS + 1, dtype=torch.float64)
    positions = torch.stack([way, 1.01 * way])[..., None]
    shown = Demonstrations(positions, PUSH, ("x",))
    return PMIL(Sliding(ends_at), shown, control_period=PUSH, state=("x",), **said).task


def steps_of_the_own_rollout(task: Task) -> tuple[int, str]:
    """Number of measured steps of a motion of the robot that learns, and why it ended."""
    trainer = make_trainer(task, 0, 1, False, lambda trial: None)
    rollout = next(iter(trainer.collector))
    return rollout.shape[-1], trainer.collector.cut_short


FELL = "the environment terminates, far from what was demonstrated"
CASES = {  # where it ends, what is shown, what is said besides, steps, and why
    "a fall": (0.55, 0.2, {"past": None, "step": PUSH}, 6, FELL),
    "farther than it ends": (0.25, 0.22, {"past": None, "step": PUSH}, 5, FELL),
    "the goal": (1.5, 1.6, {"past": None, "step": PUSH}, STEPS, ""),
    "a past": (0.55, 0.2, {"past_entries": 1, "past_actions": 1}, 6, FELL),
    "held actions": (0.55, 0.2, {"past": None, "step": 2 * PUSH}, 3, FELL),
}


@pytest.mark.parametrize("case", CASES)
def test_motion_ends_where_the_robot_has_fallen(case: str) -> None:
    ends_at, shown_until, said, steps, why = CASES[case]
    assert steps_of_the_own_rollout(task(ends_at, shown_until, **said)) == (steps, why)


def test_measured_motions_are_whole() -> None:
    robots = task(0.55, 0.2, past=None, step=PUSH).robots(3, seed=0)
    assert robots.rollout(STEPS)["next", "observation"].shape == (3, STEPS, 1)
