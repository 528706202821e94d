"""The three methods that a user writes for a robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from torch import Tensor

from torch_pmil.envs.robot import Array

Numbers = Sequence[float] | Array | Tensor


class PhysicalRobot(Protocol):
    """A robot that is read, moved and stopped.

    ``read_state`` and ``send`` are called by one thread, in turn. ``stop`` may be called by another
    thread or by the handler of a signal while one of them has not returned, and more than once. A
    lock that they share must therefore be a ``threading.RLock``.
    """

    def read_state(self) -> tuple[Numbers, float]:
        """Newest state (D,) and the time in s at which it was measured.

        The clock may be the robot's or ``time.monotonic``; it must advance from reading to reading,
        and never jump.
        The call should take much less than a control period, and must not block forever. Any
        exception ends the rollout.
        """

    def send(self, action: Numbers) -> Numbers | None:
        """Send an action (F,), which the robot holds until the next one.

        Returns the action (F,) that the robot took if its own limits changed it, else None. Any
        exception ends the rollout.
        """

    def stop(self) -> None:
        """Bring the robot to rest: zero torques, or servos that hold their position.

        It must return at once: a signal waits for it for a second, and then takes effect. A robot
        that may lose the connection also needs a watchdog of its own, which stops it when no action
        came within two periods.
        """
