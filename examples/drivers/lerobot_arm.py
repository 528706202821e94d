"""An arm of LeRobot as a physical robot. This package does not need LeRobot."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from torch_pmil.envs.physical.physical_robot import Numbers


class LeRobot(Protocol):
    """What is used of ``lerobot.robots.Robot``."""

    @property
    def is_connected(self) -> bool:
        """Whether the robot is connected."""

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the robot."""

    def get_observation(self) -> dict[str, Any]:
        """Positions by name, as ``"shoulder_pan.pos"``."""

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send targets by name; return those that were sent after the robot's own limits."""

    def disconnect(self) -> None:
        """Disconnect; most arms then go limp."""


class LeRobotArm:
    """Positions of an arm's motors as its state, and their targets as actions.

    The arm is connected if it is not connected yet. ``stop`` sends the positions that were read
    last, so that the arm holds them. Call ``robot.disconnect()`` only when nobody is below the arm.
    Velocities come from :class:`torch_pmil.envs.physical.velocity_filter.WithVelocities`.

    Args:
        robot: a robot of LeRobot.
        motors: their names, in the order of states and actions, such as ``"shoulder_pan"``.
        unit: LeRobot's unit in units of states and actions, one for all motors or one each. The
            default is a degree in rad, for arms configured with ``use_degrees=True``.

    Raises:
        KeyError: at a reading, when the robot has no such motor.

    Example:
        >>> motors = ["shoulder_pan", "elbow_flex"]
        >>> arm = LeRobotArm(SO101Follower(config), motors)  # doctest: +SKIP
    """

    def __init__(
        self, robot: LeRobot, motors: Sequence[str], unit: float | Numbers = math.pi / 180
    ) -> None:
        self._robot, self._names = robot, [f"{motor}.pos" for motor in motors]
        self._unit = torch.as_tensor(unit, dtype=torch.float64)
        self._last: Tensor | None = None
        self._bus = threading.RLock()  # of the motors, which serves one at a time
        if not robot.is_connected:
            robot.connect()

    def read_state(self) -> tuple[Tensor, float]:
        """Positions (F,) and ``time.monotonic`` before they were asked for."""
        stamp = time.monotonic()
        with self._bus:
            positions = self._vector(self._robot.get_observation())
        if positions.isfinite().all():
            self._last = positions
        return positions, stamp

    def send(self, action: Numbers) -> Tensor:
        """Send targets (F,); return what the robot's own limits made of them."""
        with self._bus:
            return self._vector(self._robot.send_action(self._by_name(action)))

    def stop(self) -> None:
        """Hold the finite positions that were read last."""
        if self._last is not None:
            self.send(self._last)

    def _vector(self, by_name: dict[str, Any]) -> Tensor:
        values = [float(by_name[name]) for name in self._names]
        return torch.tensor(values, dtype=torch.float64) * self._unit

    def _by_name(self, values: Numbers) -> dict[str, float]:
        targets = torch.as_tensor(values, dtype=torch.float64) / self._unit
        return dict(zip(self._names, targets.tolist(), strict=True))
