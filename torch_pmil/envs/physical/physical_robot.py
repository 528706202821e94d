"""What a user writes for a robot: three methods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from torch import Tensor

from torch_pmil.envs.robot import Array

Numbers = Sequence[float] | Array | Tensor


class PhysicalRobot(Protocol):
    """A robot that is read, moved and stopped.

    ``read_state`` and ``send`` are called by one thread, in turn. ``stop`` may be called by another
    thread or by the handler of a signal while one of them has not returned, and more than once.
    """

    def read_state(self) -> tuple[Numbers, float]:
        """Newest state (D,) and the time in s at which it was measured.

        The clock may be the robot's or ``time.monotonic``; it must advance from reading to reading.
        The call should take much less than a control period, and must not wait without end.

        Raises:
            Exception: the robot cannot be read; the rollout ends.
        """

    def send(self, action: Numbers) -> Numbers | None:
        """Send an action (F,), which the robot holds until the next one.

        Returns:
            The action that the robot really took, (F,), where limits of its own changed it; else
            None.

        Raises:
            Exception: the robot cannot be reached; the rollout ends.
        """

    def stop(self) -> None:
        """Bring the robot to rest: torques zero, or servos that hold where they are.

        It sends, and waits for nothing. A robot that may lose the connection needs a watchdog of
        its own besides, which stops it when no action came within two periods.
        """
