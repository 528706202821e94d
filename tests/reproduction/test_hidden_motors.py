"""Hidden motors: what is recorded of them is what the simulation had, and a model that knows them
is not worse.
"""

from __future__ import annotations

import torch

from reproduction.hidden_motors import model_data, one_step_errors, record_movements


def test_motors_are_coupled_to_their_joints_by_cables() -> None:
    states, motors, torques, successors = record_movements(seed=0, rollouts=2)
    assert states.shape == motors.shape == successors.shape == (40, 6) and torques.shape == (40, 3)
    yaw, shoulder, elbow = states[:, :3].unbind(-1)
    taut = torch.stack([yaw, shoulder, elbow + shoulder / 2], -1)
    assert (
        motors[:, :3] - taut
    ).abs().max() < 0.35  # rad, the cables' stretch under the largest torques
    assert (motors[:, :3] - taut).abs().mean() < 0.1
    assert torch.equal(successors[:19], states[1:20])


def test_known_motors_are_inputs_between_state_and_torques() -> None:
    data = record_movements(seed=0, rollouts=1)
    hidden, known = (model_data(*data, known)[0] for known in (False, True))
    assert torch.equal(known[:, :6], hidden[:, :6])
    assert torch.equal(known[:, 6:12], data[1])
    assert torch.equal(known[:, 12:], hidden[:, 6:])


def test_positions_are_predicted_better_where_the_motors_are_known() -> None:
    hidden, known = one_step_errors(0, 6, record_movements(1, 4))
    assert (known[:3] ** 2).mean() < (hidden[:3] ** 2).mean()
