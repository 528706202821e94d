"""Evidence of the past is found where it acts, and nowhere else."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.helpers.draws import Draws
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.model.past_evidence import (
    PastEvidence,
    evidence_of_past_action,
    evidence_of_past_state,
)

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))


def rollouts(draws: Draws, late: int) -> tuple[Tensor, Tensor]:
    """Rollouts of a pendulum with sensors that are a little noisy, whose torques act late."""
    actions, states = draws.uniform(-2, 2, 4, 20, 1), [draws.normal(4, 2)]
    for t in range(20):
        q, dq = states[-1].unbind(-1)
        torque = actions[:, t - late, 0] if t >= late else torch.zeros(4)
        dq = dq + 0.1 * (torque - q.sin())
        states.append(torch.stack([q + 0.1 * dq, dq], -1))
    exact = torch.stack(states, 1)
    return exact + 0.01 * draws.normal(*exact.shape), actions


@pytest.mark.parametrize("late", [0, 1, 2])
def test_past_action_is_missed_where_it_acts(draws: Draws, late: int) -> None:
    found = rollouts(draws, late)
    for periods in (1, 2):
        nats = evidence_of_past_action(*found, SPACE, periods)
        assert nats.shape == (2,)
        if periods == late:
            assert nats[1] > 20
        else:
            assert nats.sum() < 5  # what further parameters gain by chance


@pytest.mark.parametrize(
    ("of_actions", "of_state", "late", "likely"),
    [
        ({1: 31.0, 2: 10.0}, 116.0, False, True),  # a hidden motor
        ({1: -1.0, 4: 320.0}, 11.0, True, True),
        ({1: 2.0, 5: 9.0}, 1.0, True, False),  # holding five actions costs more than it gains
        ({1: 4.0, 5: 9.0}, 1.0, True, True),
    ],
)
def test_each_further_entry_of_the_state_has_its_price(
    of_actions: dict[int, float], of_state: float, late: bool, likely: bool
) -> None:
    evidence = PastEvidence(of_actions, of_state, 60, 0.05)
    assert (evidence.acts_late, evidence.is_likely) == (late, likely)
    assert evidence.periods == (4 if 4 in of_actions else 1)


def test_past_state_is_missed_where_velocities_are(draws: Draws) -> None:
    states, actions = rollouts(draws, 0)
    angle = StateSpace(("q",), ("rad",), (0,), joint_match(("q",), ("rad",)))
    blind = evidence_of_past_state(states[..., :1], actions, angle)
    assert blind.shape == (1,) and blind[0] > 20
    assert evidence_of_past_state(states, actions, SPACE).sum() < blind[0] / 4


@pytest.mark.parametrize("late", [0, 1])
def test_entry_that_never_changes_gains_nothing(draws: Draws, late: int) -> None:
    states, actions = rollouts(draws, late)
    names, units = (*NAMES, "gripper"), (*UNITS, "m")
    space = StateSpace(names, units, (0,), joint_match(names, units))
    held = torch.cat([states, torch.full_like(states[..., :1], 0.3)], -1)
    for evidence in (evidence_of_past_action, evidence_of_past_state):
        found = evidence(held, actions, space)
        assert found[2] == 0
        torch.testing.assert_close(found[:2], evidence(states, actions, SPACE), rtol=0, atol=0.5)


def test_what_does_not_fit_is_refused(draws: Draws) -> None:
    states, actions = rollouts(draws, 0)
    with pytest.raises(ValueError, match="periods must be from 1 to 19, got 20"):
        evidence_of_past_action(states, actions, SPACE, 20)
    with pytest.raises(ValueError, match="actions must have shape"):
        evidence_of_past_action(states, actions[:, 1:], SPACE)
