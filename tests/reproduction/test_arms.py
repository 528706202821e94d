"""The arms that carry a bottle: what they are shown, how their servos are, and what fails."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
import torch

from reproduction import arms, ur5e
from reproduction.arms import PANDA, UR5E, Arm, arm_experiment, motion, servo_alone
from torch_pmil.demonstrations import Demonstrations

ARMS = pytest.mark.parametrize("arm", [UR5E, PANDA], ids=["ur5e", "panda"])
needs_robosuite = pytest.mark.skipif(
    find_spec("robosuite") is None, reason=f"needs robosuite: {arms.INSTALL}"
)


def test_missing_models_are_an_error_that_says_how_to_get_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(arms, "find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="pip install --no-deps robosuite==1"):
        arms.arm_spec(UR5E)


@ARMS
def test_motion_passes_its_poses_and_rests_at_both_ends(arm: Arm) -> None:
    poses, times = np.array(arm.poses), np.array(arm.times)
    path = motion(poses, times)
    for pose, time in zip(poses, times, strict=True):
        assert path(time) == pytest.approx(pose)
    for time in (-arms.SETTLING, 0.0, times[-1], arms.DURATION):
        assert path(time, 1) == pytest.approx(np.zeros(len(arm.joints)), abs=1e-9)


def test_distance_is_the_rms_over_joints_and_times() -> None:
    shown = Demonstrations(torch.zeros(3, 5, 2).double(), 0.05, ("a", "b"))
    states = torch.zeros(4, 5, 4).double()
    states[:, 1:, 0] = 0.2
    assert arms.Distance(shown)(states).tolist() == pytest.approx([0.2 / 2**0.5] * 4)


def test_headline_counts_the_seeds_that_came_near_enough() -> None:
    runs = [
        {"ratio": ratio, "experience_s": 6.0, "wall_seconds": 80.0, "two_sigma_coverage": 0.6}
        for ratio in (0.7, 1.25, 1.3)
    ]
    headline = ur5e.headline_of(runs)
    assert (headline["seeds_solved"], headline["seeds"]) == (2, 3)
    assert (headline["median_ratio"], headline["worst_ratio"]) == (1.25, 1.3)


@needs_robosuite
@pytest.mark.robot
@ARMS
def test_arm_learns_joint_targets_near_what_a_person_showed(arm: Arm) -> None:
    task, count = arm_experiment(arm), len(arm.joints)
    shown = task.demonstrations
    assert task.actions.names == shown.names == arm.joints
    assert shown.positions.shape == (5, 61, count)
    assert 1.5 < np.rad2deg(arms.spread(shown)) < 4
    assert task.make_dynamics().num_outputs == count
    assert task.exploration.around == pytest.approx(shown.positions.mean(0)[1:], abs=1e-6)
    low, high = shown.positions.aminmax(dim=0)
    assert (task.actions.low <= low).all() and (task.actions.high >= high).all()


@needs_robosuite
@pytest.mark.robot
def test_servos_alone_fall_behind_the_demonstrations() -> None:
    task = arm_experiment(UR5E)
    assert 1.25 < ur5e.ratio_of(servo_alone(task, 4, 1), task) < 4


@needs_robosuite
@pytest.mark.robot
def test_baseline_has_the_cost_of_the_last_pose_and_the_same_first_motion() -> None:
    task, pilco = arm_experiment(UR5E), arms.pilco_experiment(UR5E)
    last = zip(
        task.space.match_space.names, task.demonstrations.positions[:, -1].mean(0), strict=True
    )
    assert pilco.cost.target == {name: place.item() for name, place in last}
    assert torch.equal(pilco.exploration.around, task.exploration.around)
