"""The pendubot's task: what it matches, what a success is, what its demonstrations show."""

from __future__ import annotations

import math

import torch

from torch_pmil.envs.pendubot import tip_height
from torch_pmil.tasks.one_motor import FINAL_SAMPLES, LINE, depth_below_upright, one_motor_space
from torch_pmil.tasks.registry import load_experiment


def test_task_is_3_s_at_25_hz_with_one_torque() -> None:
    task = load_experiment("pendubot")
    assert (task.horizon, task.demonstrations.time_step) == (75, 0.04)
    assert str(task.actions) == "tau1 (N·m) from -6 to 6"


def test_demonstrations_start_hanging_and_succeed() -> None:
    task = load_experiment("pendubot")
    heights = task.demonstrations.positions[..., 3]
    assert (heights[:, 0] < -0.45).all()
    assert (heights[:, -FINAL_SAMPLES:] > LINE).all()
    states = task.demonstrated_states.unflatten(0, task.demonstrations.positions.shape[:2])
    torch.testing.assert_close(one_motor_space().observe(states), task.demonstrations.positions)


def test_success_is_a_tip_above_the_line_to_the_end() -> None:
    tolerance = load_experiment("pendubot").tolerance
    upright = torch.zeros(76, 4, dtype=torch.float64)
    fallen = upright.clone()
    fallen[-FINAL_SAMPLES, 0] = math.acos(LINE / 0.5) + 0.01
    early = upright.clone()
    early[:-FINAL_SAMPLES] = math.pi
    depths = depth_below_upright(torch.stack([upright, fallen, early]))
    assert (depths <= tolerance).tolist() == [True, False, True]
    assert tip_height(upright).unique().tolist() == [0.5]
