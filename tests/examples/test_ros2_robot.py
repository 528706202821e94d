"""A robot under ROS 2, faked after the messages of ``sensor_msgs`` and ``std_msgs``."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import pytest

from examples.drivers.ros2_robot import Ros2Robot
from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.velocity_filter import VelocityFilter


@dataclass
class Time:
    sec: int = 0
    nanosec: int = 0


@dataclass
class Header:
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class JointState:
    header: Header = field(default_factory=Header)
    name: list[str] = field(default_factory=list)
    position: list[float] = field(default_factory=list)
    velocity: list[float] = field(default_factory=list)
    effort: list[float] = field(default_factory=list)


@dataclass
class Float64MultiArray:
    layout: object = None
    data: list[float] = field(default_factory=list)


class FakePublisher:
    def __init__(self) -> None:
        self.published: list[list[float]] = []

    def publish(self, msg: Float64MultiArray) -> None:
        assert isinstance(msg, Float64MultiArray) and all(type(x) is float for x in msg.data)
        self.published.append(msg.data)


def state(positions: list[float], velocities: list[float], nanosec: int = 0) -> JointState:
    """Of three joints, of which the robot uses two, in another order."""
    header = Header(Time(1_700_000_000, nanosec))
    return JointState(header, ["knee", "finger", "hip"], positions, velocities)


def made(**settings: object) -> tuple[Ros2Robot, FakePublisher]:
    publisher = FakePublisher()
    robot = Ros2Robot(publisher, Float64MultiArray, ["hip", "knee"], 0.05, **settings)
    return robot, publisher


def test_joints_are_found_by_their_names() -> None:
    robot, _ = made()
    robot.on_joint_state(state([1.0, 2.0, 3.0], [0.1, 0.2, 0.3], nanosec=250_000_000))
    entries, stamp = robot.read_state()
    assert entries.tolist() == [3.0, 0.3, 1.0, 0.1] and stamp == 1_700_000_000.25


def test_commands_are_lists_of_floats() -> None:
    robot, publisher = made()
    robot.on_joint_state(state([1.0, 2.0, 3.0], [0.0] * 3))
    robot.send(robot.read_state()[0][:2])
    assert publisher.published == [[3.0, 0.0]]


@pytest.mark.parametrize("missing", [[], [math.nan, 0.0, math.nan]])
def test_velocities_that_are_missing_come_from_the_filter(missing: list[float]) -> None:
    robot, _ = made(velocity_filter=VelocityFilter(0.0))
    robot.on_joint_state(state([1.0, 2.0, 3.0], missing))
    robot.on_joint_state(state([1.5, 2.0, 2.0], missing, nanosec=500_000_000))
    assert robot.read_state()[0].tolist() == pytest.approx([2.0, -2.0, 1.5, 1.0])
    plain, _ = made()
    plain.on_joint_state(state([1.0, 2.0, 3.0], missing))
    with pytest.raises(RobotError, match="the joint states hold no velocities"):
        plain.read_state()


def test_states_that_do_not_come_or_are_old_are_told() -> None:
    robot, _ = made()
    robot.on_joint_state(JointState(name=["finger"], position=[1.0]))
    with pytest.raises(RobotError, match="no joint state of hip, knee has come"):
        robot.read_state()
    robot.on_joint_state(state([1.0, 2.0, 3.0], [0.0] * 3))
    time.sleep(0.06)
    with pytest.raises(RobotError, match=r"no joint state has come for 0\.\d+ s"):
        robot.read_state()


@pytest.mark.parametrize(
    ("interface", "expected"),
    [("position", [3.0, 1.0]), ("velocity", [0.0, 0.0]), ("effort", [0.0, 0.0])],
)
def test_robot_that_is_stopped_stays(interface: str, expected: list[float]) -> None:
    robot, publisher = made(interface=interface)
    robot.on_joint_state(state([1.0, 2.0, 3.0], [0.0] * 3))
    robot.stop()
    assert publisher.published == [expected]


@pytest.mark.parametrize("positions", [[math.nan, 2.0, 3.0], [1.0]])
def test_message_without_a_position_is_passed_over(positions: list[float]) -> None:
    robot, publisher = made()
    robot.on_joint_state(state([1.0, 2.0, 3.0], [0.0] * 3))
    robot.on_joint_state(state(positions, [0.0] * 3))
    robot.stop()
    assert publisher.published == [[3.0, 1.0]]


def test_interface_that_does_not_exist_is_told() -> None:
    with pytest.raises(ValueError, match="interface must be position, velocity or effort"):
        made(interface="torque")
