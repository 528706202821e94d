"""An arm of LeRobot, faked after the signatures of ``lerobot.robots.Robot`` (0.4)."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest
import torch

from examples.drivers.lerobot_arm import LeRobotArm
from tests.helpers.fake_robot import PERIOD
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv
from torch_pmil.envs.physical.velocity_filter import VelocityFilter, WithVelocities

MOTORS = ("shoulder_pan", "elbow_flex", "gripper")
LARGEST = 20.0  # degrees from the position, as max_relative_target


class FakeArm:
    """Jumps to its targets, which it caps; shows a picture beside its positions."""

    def __init__(self) -> None:
        self.is_connected, self.positions = False, dict.fromkeys(MOTORS, 10.0)

    @property
    def action_features(self) -> dict:
        return {f"{motor}.pos": float for motor in MOTORS}

    def connect(self, calibrate: bool = True) -> None:
        assert not self.is_connected
        self.is_connected = True

    def get_observation(self) -> dict[str, Any]:
        assert self.is_connected
        return {**{f"{motor}.pos": q for motor, q in self.positions.items()}, "wrist": object()}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        assert self.is_connected
        assert set(action) <= set(self.action_features)
        for name, target in action.items():
            q = self.positions[name.removesuffix(".pos")]
            self.positions[name.removesuffix(".pos")] = min(max(target, q - LARGEST), q + LARGEST)
        return {name: self.positions[name.removesuffix(".pos")] for name in action}

    def disconnect(self) -> None:
        self.is_connected = False


def test_positions_and_targets_are_in_the_order_and_units_asked_for() -> None:
    fake = FakeArm()
    fake.positions["gripper"] = 40.0
    arm = LeRobotArm(fake, ["gripper", "elbow_flex"], unit=[0.01, math.pi / 180])
    state, stamp = arm.read_state()
    assert state.tolist() == pytest.approx([0.4, math.radians(10)])
    assert 0 <= time.monotonic() - stamp < 1
    arm.send([0.5, math.radians(20)])
    assert fake.positions == pytest.approx({"shoulder_pan": 10, "elbow_flex": 20, "gripper": 50})


def test_arm_that_is_connected_is_not_connected_again() -> None:
    fake = FakeArm()
    fake.connect()
    LeRobotArm(fake, MOTORS)
    assert fake.is_connected


def test_what_the_limits_of_the_arm_made_of_an_action_is_told() -> None:
    arm = LeRobotArm(FakeArm(), MOTORS, unit=1.0)
    assert arm.send([90.0, 15.0, -90.0]).tolist() == [30.0, 15.0, -10.0]


def test_arm_that_is_stopped_holds_where_it_was_last() -> None:
    fake = FakeArm()
    arm = LeRobotArm(fake, MOTORS, unit=1.0)
    arm.stop()
    assert fake.positions == dict.fromkeys(MOTORS, 10.0)
    arm.send([25.0, 25.0, 25.0])
    arm.read_state()
    fake.positions["gripper"] = 28.0
    arm.stop()
    assert fake.positions == dict.fromkeys(MOTORS, 25.0)


def test_reading_that_is_not_finite_is_no_target() -> None:
    fake = FakeArm()
    arm = LeRobotArm(fake, MOTORS, unit=1.0)
    arm.read_state()
    fake.positions = dict.fromkeys(MOTORS, math.nan)
    arm.read_state()
    sent = []
    fake.send_action = lambda action: sent.append(action) or action
    arm.stop()
    assert list(sent[0].values()) == [10.0] * 3


def test_motor_that_the_arm_has_not_is_told() -> None:
    with pytest.raises(KeyError, match=r"tail\.pos"):
        LeRobotArm(FakeArm(), ["tail"]).read_state()


def test_arm_runs_in_the_environment() -> None:
    robot = WithVelocities(LeRobotArm(FakeArm(), MOTORS, unit=1.0), VelocityFilter(0.0))
    env = PhysicalRobotEnv(
        robot,
        dim=6,
        low=[-100.0] * 3,
        high=[100.0] * 3,
        control_period=PERIOD,
        operator=lambda: None,
    )
    action = torch.tensor([90.0, 12.0, 10.0], dtype=torch.float64)
    rollout = env.rollout(2, lambda tensordict: tensordict.set("action", action))
    env.close()
    assert rollout["next", "sent"].tolist() == [[30.0, 12.0, 10.0], [50.0, 12.0, 10.0]]
    assert rollout["next", "observation"][:, ::2].tolist() == rollout["next", "sent"].tolist()
    assert rollout["next", "observation"][0, 1].item() == pytest.approx(20 / PERIOD, rel=0.3)
