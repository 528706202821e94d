"""A robot without a body, which does what a test wants."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from torch_pmil.envs.physical.physical_robot import Numbers
from torch_pmil.envs.physical.physical_robot_env import PhysicalRobotEnv

PERIOD = 0.08  # s


class FakeRobot:
    """Counts its readings in the first entry of its state, and remembers all calls.

    Args:
        faults: what to do at a reading, by its number from 0; the two of the reset are the first.
            It returns state and time stamp, or None for the usual ones.
    """

    def __init__(
        self, faults: dict[int, Callable[[], tuple[Numbers, float] | None]] | None = None
    ) -> None:
        self.faults = faults or {}
        self.readings, self.calls, self.sent = 0, list[str](), list[list[float]]()
        self.stopped_at = 0.0

    def read_state(self) -> tuple[Numbers, float]:
        fault = self.faults.get(self.readings, lambda: None)
        self.readings += 1
        self.calls.append("read")
        return fault() or ([float(self.readings), 0.0], time.monotonic())

    def send(self, action: Numbers) -> None:
        self.calls.append("send")
        self.sent.append([float(entry) for entry in action])

    def stop(self) -> None:
        self.calls.append("stop")
        self.stopped_at = time.monotonic()


def fake_env(robot: FakeRobot, **settings: Any) -> PhysicalRobotEnv:
    """The environment of a fake robot with an operator who does nothing."""
    defaults = {"dim": 2, "low": [-1.0, 0.0], "high": [1.0, 3.0], "control_period": PERIOD}
    return PhysicalRobotEnv(robot, **{**defaults, "operator": lambda: None, **settings})
