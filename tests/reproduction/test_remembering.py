"""States that remember: the robots are those without a memory, and no two tasks share runs."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from reproduction import PAPER
from reproduction.biorob_history import remembering_biorob
from reproduction.delay_calibration import with_delay
from reproduction.remembering import delayed, positions_only
from torch_pmil.envs.rollouts import states_of
from torch_pmil.tasks.registry import load_experiment


@pytest.mark.robot
def test_robots_are_the_same_but_for_what_they_remember() -> None:
    late, half = delayed().values()
    pairs = (
        (late, with_delay(0.1)),
        (half, with_delay(0.05)),
        (remembering_biorob(), load_experiment("biorob")),
    )
    for task, plain in pairs:
        states, shown = (states_of(one.robot(seed=2).rollout(3)) for one in (task, plain))
        torch.testing.assert_close(states[0, : plain.space.dim], shown[0])
    (task,) = positions_only().values()
    assert task.history.hidden == ("dq1", "dq2") and task.make_dynamics().num_outputs == 2


@pytest.mark.parametrize(
    ("name", "tasks"), [("positions_only", 1), ("delay", 2), ("biorob_history", 2), ("noise", 4)]
)
def test_each_task_has_runs_of_its_own(name: str, tasks: int) -> None:
    runs = PAPER[name].runs(Path("runs"), False)
    assert len({run.out for run in runs}) == len(runs) == 10 * tasks
