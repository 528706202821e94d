"""A robot under ROS 2 as a physical robot. This package does not need ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from torch_pmil.checks import check_positive
from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers
from torch_pmil.envs.physical.velocity_filter import VelocityFilter


class Publisher(Protocol):
    """What is used of ``rclpy.publisher.Publisher``."""

    def publish(self, msg: Any) -> None:
        """Send a message."""


class Ros2Robot:
    """Joint states in, commands to a forward command controller out.

    The user makes the node, subscribes :meth:`on_joint_state` to ``sensor_msgs/JointState`` and
    spins the node in another thread. The state is ``[q1, dq1, q2, dq2, ...]``. If a message lacks
    velocities, they come from the filter, which sees each such message. ``stop`` commands the
    positions that came last, or zeros where the controller takes velocities or efforts.

    Args:
        publisher: of the controller's topic, as ``/forward_position_controller/commands``.
        command: ``std_msgs.msg.Float64MultiArray``.
        joints: names, in the order of states and of the controller's parameter ``joints``.
        timeout: age in s beyond which a joint state is no longer that of a robot in order.
        interface: of the controller: "position", "velocity" or "effort".
        velocity_filter: for robots that measure positions alone.

    Raises:
        ValueError: there is no such interface.

    Example:
        >>> publisher = node.create_publisher(
        ...     Float64MultiArray, "/forward_position_controller/commands", 1
        ... )  # doctest: +SKIP
        >>> robot = Ros2Robot(publisher, Float64MultiArray, ["hip", "knee"], 0.05)  # doctest: +SKIP
        >>> node.create_subscription(
        ...     JointState, "/joint_states", robot.on_joint_state, 1
        ... )  # doctest: +SKIP
        >>> threading.Thread(target=rclpy.spin, args=[node], daemon=True).start()  # doctest: +SKIP
    """

    def __init__(
        self,
        publisher: Publisher,
        command: Callable[..., Any],
        joints: Sequence[str],
        timeout: float,
        interface: str = "position",
        velocity_filter: VelocityFilter | None = None,
    ) -> None:
        if interface not in ("position", "velocity", "effort"):
            raise ValueError(f"interface must be position, velocity or effort, got {interface}")
        check_positive("timeout", timeout)
        self._publisher, self._command, self._joints = publisher, command, list(joints)
        self._timeout, self._interface, self._filter = timeout, interface, velocity_filter
        self._latest: _JointState | None = None

    def on_joint_state(self, message: Any) -> None:
        """Take a ``sensor_msgs/JointState``; one without a joint or its position is passed over."""
        if set(self._joints) <= set(message.name):
            order = [list(message.name).index(joint) for joint in self._joints]
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            positions = _entries(message.position, order)
            velocities = _entries(message.velocity, order)
            if not positions.isfinite().all():
                return  # stop() commands the positions that came last
            if self._filter is not None and velocities.isnan().any():
                velocities = self._filter.update(positions, stamp)
            self._latest = _JointState(positions, velocities, stamp, time.monotonic())

    def read_state(self) -> tuple[Tensor, float]:
        """Newest state (2J,) and the time stamp of its header.

        Raises:
            RobotError: none came for a time, or it holds no velocities and there is no filter.
        """
        latest = self._latest
        if latest is None:
            raise RobotError(f"no joint state of {', '.join(self._joints)} has come")
        age = time.monotonic() - latest.arrival
        if age > self._timeout:
            raise RobotError(f"no joint state has come for {age:.3f} s")
        if latest.velocities.isnan().any():
            raise RobotError("the joint states hold no velocities: give a velocity_filter")
        return torch.stack([latest.positions, latest.velocities], dim=-1).flatten(), latest.stamp

    def send(self, action: Numbers) -> None:
        """Publish a command (F,)."""
        self._publisher.publish(self._command(data=[float(entry) for entry in action]))

    def stop(self) -> None:
        """Stay where the robot was last, or command zeros."""
        latest = self._latest
        if self._interface != "position":
            self.send([0.0] * len(self._joints))
        elif latest is not None:
            self.send(latest.positions)


@dataclass(frozen=True, eq=False)
class _JointState:
    positions: Tensor  # (J,)
    velocities: Tensor  # (J,); NaN where the message has none
    stamp: float  # s, of the header
    arrival: float  # s, of the monotonic clock


def _entries(values: Sequence[float], order: Sequence[int]) -> Tensor:
    """Entries of an array of the message, which is empty where the robot does not measure them."""
    known = [float(values[index]) if index < len(values) else torch.nan for index in order]
    return torch.tensor(known, dtype=torch.float64)
