"""The servos' reproductions: what is varied is what the name says, and a servo alone is alone."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import torch

from reproduction import double_pendulum_servo, servo_gains
from reproduction.double_pendulum_servo import varied, with_servos
from reproduction.figure7 import experience_to_goal
from reproduction.servo_gains import LEARNED, success_alone, with_gains

pytestmark = pytest.mark.robot


def test_robots_are_varied_as_their_names_say() -> None:
    made = varied()
    assert list(made) == ["success_0.15kg", "success_1kg"]
    assert made["success_1kg"].robot(seed=0).model.body("link2").mass == 1.0


def test_heavier_robot_is_held_by_what_holds_it() -> None:
    experiment = with_servos("1kg", link_masses=(0.5, 1.0))
    raised = torch.tensor([[2.9, 0.0, 0.1, 0.0]], dtype=torch.float64)
    held = experiment.holding_actions(raised)
    after = experiment.robot(seed=0).simulate(raised, held)
    torch.testing.assert_close(after, raised, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "needed", [double_pendulum_servo.needed_runs, servo_gains.needed_runs], ids=["servo", "gains"]
)
def test_runs_have_folders_of_their_own_and_go_to_other_processes(needed) -> None:
    runs = needed(Path("runs"), quick=True)
    assert len({run.out for run in runs}) == len(runs)
    assert pickle.loads(pickle.dumps(runs[-1].learn)).func is runs[-1].learn.func


def test_stiff_servos_alone_swing_up_and_soft_ones_do_not() -> None:
    assert success_alone(with_gains(100.0, 3.0)) == success_alone(with_gains(100.0, 3.0), True) == 1
    assert success_alone(with_gains(3.0, 1.0)) == 0


def test_experience_is_that_of_the_first_trial_that_reaches_the_goal() -> None:
    rates = [0.0, 0.94, 0.95, 0.0]
    trials = [{"experience_s": 2.5 * (k + 1), "success_rate": r} for k, r in enumerate(rates)]
    assert experience_to_goal({"trials": trials}) == 7.5
    assert len(set(LEARNED)) == len(LEARNED)
