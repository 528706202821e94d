"""Hidden motors: recorded as the simulation had them, and a model that knows them."""

from __future__ import annotations

import torch

from reproduction.hidden_motors import KINDS, model_data, one_step_errors, record_movements


def test_motors_are_coupled_to_their_joints_by_cables() -> None:
    recorded = record_movements(seed=0, rollouts=2)
    states, motors, successors = recorded.states, recorded.motors, recorded.successors
    assert states.shape == motors.shape == successors.shape == (40, 6)
    assert recorded.torques.shape == (40, 3)
    yaw, shoulder, elbow = states[:, :3].unbind(-1)
    taut = torch.stack([yaw, shoulder, elbow + shoulder / 2], -1)
    stretch = (motors[:, :3] - taut).abs()  # rad
    assert stretch.max() < 0.35 and stretch.mean() < 0.1
    assert torch.equal(successors[:19], states[1:20])


def test_models_see_what_their_names_say() -> None:
    data = record_movements(seed=0, rollouts=1)
    hidden, known, remembered = (model_data(data, kind)[0] for kind in KINDS)
    assert torch.equal(known[:, :6], hidden[:, :6])
    assert torch.equal(known[:, 6:12], data.motors)
    assert torch.equal(known[:, 12:], hidden[:, 6:])
    assert torch.equal(remembered[1:, 6:12], data.states[:-1])
    assert torch.equal(remembered[1:, 18:21], data.torques[:-1])


def test_positions_are_predicted_better_where_the_motors_are_known_or_remembered() -> None:
    hidden, known, remembered = one_step_errors(0, 6, record_movements(1, 4))
    assert (known[:3] ** 2).mean() < (hidden[:3] ** 2).mean()
    assert (remembered[:3] ** 2).mean() < (hidden[:3] ** 2).mean()
