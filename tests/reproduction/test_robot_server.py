"""What the reproduction of the robot server counts."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

pytest.importorskip("zmq", reason="needs the extra remote")

from reproduction.robot_server import results, step_time_errors
from tests.helpers.draws import Draws
from torch_pmil.files import write_json


def test_step_time_errors_are_those_of_the_times_between_actions(draws: Draws) -> None:
    """Of readings at deadlines one period apart, after which each action comes with a delay."""
    period, steps = 0.1, 50
    overrun = draws.uniform(0.0, 0.003, steps, 1)
    delay = draws.uniform(0.0, 0.003, steps, 1)
    late = torch.cat([torch.zeros(1), overrun[:-1, 0]])
    readings = period * torch.arange(steps, dtype=torch.float64) + late
    sent = readings + delay[:, 0]
    rollout = TensorDict({"next": {"delay": delay, "overrun": overrun}}, steps)
    expected = (sent.diff() - period).abs()
    torch.testing.assert_close(step_time_errors(rollout), expected, rtol=0, atol=1e-12)


def test_headline_counts_what_was_measured(tmp_path: Path) -> None:
    punctual = {"within_2ms": 0.995, "late": 0.002}
    measured = {
        "learned": [{"saved_success_rate": 1.0}, {"saved_success_rate": 0.0}],
        "kills": [{"survived": True}, {"survived": False}, {"survived": True}],
        "steps_10hz": punctual,
        "steps_50hz": punctual,
    }
    write_json(tmp_path / "summary.json", measured)
    found = results([tmp_path], quick=False)
    assert found.headline == {
        "seeds_learned": 1,
        "seeds": 2,
        "kills_survived": 2,
        "kills": 3,
        "steps_within_2ms": 0.995,
        "late_steps_50hz": 0.002,
    }
    assert found.details == measured
