"""What an experiment says of the robot and its first policy."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.helpers.short_run import PD_MOVEMENTS
from torch_pmil.control.exploration import RandomTorques
from torch_pmil.experiments import Experiment, load_experiment

WIDTHS = torch.tensor([2.0, 3.0, 0.5, 0.6, 0.7, 0.8], dtype=torch.float64)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return load_experiment("double_pendulum")


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def lifting(states: Tensor) -> Tensor:
    """Any torques that depend on the state."""
    return torch.stack([1.5 + 0.3 * states[..., 1], -0.8 + 0.2 * states[..., 3]], -1)


def test_exploration_is_one_random_rollout_unless_it_is_said(experiment: Experiment) -> None:
    exploration = experiment.exploration
    assert isinstance(exploration, RandomTorques) and exploration.u_max is experiment.u_max
    assert exploration.settings == {"rollouts": 1, "steps": 25, "random_torque": 0.4}
    assert replace(experiment, pd_movements=PD_MOVEMENTS).exploration is PD_MOVEMENTS


def test_new_policy_holds_the_robot_at_its_starts(experiment: Experiment) -> None:
    """To 5 % rms of the torques, at starts that the fit did not see."""
    starts = experiment.initial.sample(500, torch.Generator().manual_seed(1))
    policy = replace(experiment, holding_torques=lifting).make_policy(generator())
    error = (policy(experiment.space.features(starts)) - lifting(starts)).detach()
    assert (error.square().mean(0).sqrt() < 0.05 * lifting(starts).abs().amax(0)).all()


def test_policy_that_holds_is_random_elsewhere_as_any_other(experiment: Experiment) -> None:
    """Far from the start, where no basis function that acts at the start reaches."""
    plain, holding = (
        each.make_policy(generator())
        for each in (experiment, replace(experiment, holding_torques=lifting))
    )
    far = experiment.space.features(torch.tensor([0.0, 6.0, 2.0, -6.0], dtype=torch.float64))
    torch.testing.assert_close(holding(far), plain(far), rtol=0, atol=0.02)
    assert torch.equal(holding.centres, plain.centres)


def test_widths_may_be_said_in_the_units_of_the_features(experiment: Experiment) -> None:
    plain, wide = (
        each.make_policy(generator())
        for each in (experiment, replace(experiment, input_widths=WIDTHS))
    )
    assert torch.equal(wide.controller.network.lengthscales, WIDTHS.expand(2, 6))
    torch.testing.assert_close(wide.centres * wide.scale, plain.centres * plain.scale)


def test_settings_say_what_the_first_policy_and_motion_are(experiment: Experiment) -> None:
    noise_std = torch.tensor([0.1, 0.2, 0.3, 0.4], dtype=torch.float64)
    changed = replace(
        experiment,
        noise_std=noise_std,
        input_widths=WIDTHS,
        holding_torques=lifting,
        pd_movements=PD_MOVEMENTS,
    )
    assert (changed.settings["noise_std"], changed.settings["input_widths"]) == (
        noise_std.tolist(),
        WIDTHS.tolist(),
    )
    assert changed.settings["holds_start"] and not experiment.settings["holds_start"]
    assert changed.settings["exploration"]["gain"] == PD_MOVEMENTS.gain.tolist()
