"""States that are recovered show what was observed."""

from __future__ import annotations

import numpy as np
import torch
from torch.testing import assert_close

from torch_pmil.control.recovered_states import rates_of, recover_states
from torch_pmil.control.state_space import MatchSpace
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.tasks.double_pendulum import double_pendulum_space

NAMES = ("q1", "dq1", "q2", "dq2")


def test_states_of_link_positions_are_those_of_the_arctangents() -> None:
    shown = shipped_demonstrations("double_pendulum")
    space = double_pendulum_space()
    x1, y1, x2, y2 = shown.positions.unbind(-1)
    first, both = torch.atan2(x1, y1), torch.atan2(x2 - x1, y2 - y1)
    q1, both = (torch.from_numpy(np.unwrap(each.numpy())) for each in (first, both))
    dq1, dq2 = (torch.gradient(q, spacing=0.1, dim=-1)[0] for q in (q1, both - q1))
    expected = torch.stack([q1, dq1, both - q1, dq2], -1)
    found = recover_states(
        space.match_space, shown.positions, shown.time_step, expected[:, 0].mean(0), rates_of(NAMES)
    )
    # least squares end at steps of 1e-8, and the weight on staying biases them by its square
    # whole turns apart
    assert_close(space.features(found), space.features(expected), atol=1e-4, rtol=1e-4)


def test_what_is_shown_is_met_and_what_is_not_stays_or_is_derived() -> None:
    space = MatchSpace.of_entries(("q1",), NAMES)
    q1 = torch.linspace(0, 1, 11, dtype=torch.float64).square()
    start = torch.tensor([0.0, 0.0, 0.7, 0.0], dtype=torch.float64)
    found = recover_states(space, q1[None, :, None], 0.1, start, rates_of(NAMES))[0]
    assert_close(space(found)[:, 0], q1, atol=1e-5, rtol=0)
    assert_close(found[:, 1], torch.gradient(q1, spacing=0.1)[0], atol=1e-3, rtol=0)
    assert_close(found[:, 2], torch.full((11,), 0.7).double(), atol=1e-6, rtol=0)
    assert_close(found[:, 3], torch.zeros(11).double(), atol=1e-6, rtol=0)


def test_a_velocity_that_was_shown_is_not_derived() -> None:
    names = ("q", "dq")
    shown = torch.tensor([[[0.0, 3.0], [0.1, -2.0], [0.2, 5.0]]], dtype=torch.float64)
    found = recover_states(
        MatchSpace.of_entries(names, names), shown, 0.1, torch.zeros(2), rates_of(names)
    )
    # the weight on staying biases by its square, of changes of 7 in units of 3
    assert_close(found, shown, atol=1e-4, rtol=0)
