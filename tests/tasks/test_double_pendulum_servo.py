"""The swing-up by position servos."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torch_pmil.control.exploration import RandomActions
from torch_pmil.control.policy_file import load_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.runs.diagnosis.before_a_run import check
from torch_pmil.runs.training import train
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task

pytestmark = pytest.mark.robot


@pytest.fixture(scope="module")
def experiment() -> Task:
    return load_experiment("double_pendulum_servo")


def test_actions_are_angles_for_the_servos(experiment: Task) -> None:
    assert str(experiment.actions) == ("setpoint1 (rad) from -4 to 4, setpoint2 (rad) from -3 to 3")
    assert check(experiment) == []


def test_demonstrated_angles_begin_near_the_start_and_show_the_same(experiment: Task) -> None:
    states, plain = experiment.demonstrated_states, load_experiment("double_pendulum")
    torch.testing.assert_close(
        experiment.space.observe(states), plain.space.observe(plain.demonstrated_states)
    )
    started = states.unflatten(0, (5, -1))[:, 0, ::2]
    assert ((started - experiment.initial.mean[::2]).abs() < 0.3).all()


def test_first_motion_is_around_what_holds_the_start(experiment: Task) -> None:
    exploration = experiment.exploration
    assert isinstance(exploration, RandomActions)
    assert exploration.around.tolist() == pytest.approx([torch.pi, 0.0])


def test_first_motion_may_go_along_what_was_demonstrated(experiment: Task) -> None:
    along = experiment.with_settings(explore_demonstrated=True)
    mean = experiment.demonstrated_states.unflatten(0, (5, -1)).mean(0)
    assert torch.equal(along.exploration.around, experiment.holding_actions(mean[1:]))
    assert along.adjustable["explore_demonstrated"] is True


def test_motion_along_the_demonstrations_needs_what_holds_the_robot(experiment: Task) -> None:
    for changes in ({"holding_actions": None}, {"demonstrated_states": torch.zeros(7, 4).double()}):
        with pytest.raises(ValueError, match=r"explore_demonstrated needs (holding|demonstrated_)"):
            replace(experiment, **changes).with_settings(explore_demonstrated=True)


def test_first_policy_holds_the_robot_at_its_starts_and_along_the_demonstrations(
    experiment: Task,
) -> None:
    """To 0.1 rad rms, at starts that the fit did not see; one for the starts alone does not."""
    starts = experiment.initial.sample(500, torch.Generator().manual_seed(1))
    both, starts_alone = (
        each.make_policy(torch.Generator().manual_seed(0))
        for each in (experiment, replace(experiment, held_states=None))
    )
    assert (error_of(both, starts, experiment) < 0.1).all()
    assert (error_of(both, experiment.demonstrated_states, experiment) < 0.1).all()
    assert (error_of(starts_alone, starts, experiment) < 0.1).all()
    assert (error_of(starts_alone, experiment.demonstrated_states, experiment) > 1).all()


def error_of(policy: RBFPolicy, states: Tensor, experiment: Task) -> Tensor:
    """Root mean square difference from what holds the robot, (F,)."""
    actions = policy(experiment.space.features(states)).detach()
    return (actions - experiment.holding_actions(states)).square().mean(0).sqrt()


@pytest.mark.slow
def test_servo_learns_and_its_policy_says_its_actions(experiment: Task, tmp_path) -> None:
    result = train(experiment, 100, 6, tmp_path / "run", "", progress_bar=False)
    assert result.summary["saved_success_rate"] >= 0.9
    assert result.summary["saturated"].keys() == {"setpoint1", "setpoint2"}
    policy = load_policy(tmp_path / "run" / "policy.pt")
    assert str(policy.actions) == str(experiment.actions)
