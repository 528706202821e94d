"""Deadlines and readings of one rollout, and how old the readings are."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers


class ControlClock:
    """Deadlines that do not drift: each is one ``period``, in s, after the one before.

    Example:
        >>> clock = ControlClock(0.01)
        >>> clock.wait()
        >>> clock.lag() >= 0
        True
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.start()

    def start(self) -> None:
        """Count the deadlines from now on."""
        self._deadline = time.monotonic()

    def wait(self) -> None:
        """Sleep until the next deadline, or return at once if it has passed."""
        self._deadline += self.period
        time.sleep(max(0.0, self._deadline - time.monotonic()))

    def lag(self) -> float:
        """Seconds since the last deadline that was waited for."""
        return time.monotonic() - self._deadline


@dataclass(frozen=True, eq=False)
class Reading:
    """A state and its times."""

    state: Tensor  # (D,)
    stamp: float  # of the measurement, in s of the robot's clock
    taken: float  # of the arrival, in s of time.monotonic


class Readings:
    """The first and the latest reading of a rollout.

    Args:
        read_state: of a :class:`~torch_pmil.envs.physical.physical_robot.PhysicalRobot`.
        dim: entries D of its state.

    Example:
        >>> readings = Readings(lambda: ([0.5, 0.0], time.monotonic()), dim=2)
        >>> readings.begin(pause=0.01)
        >>> readings.take()
        >>> readings.latest.state, readings.repeated(), abs(readings.age()) < 0.01
        (tensor([0.5000, 0.0000], dtype=torch.float64), False, True)
    """

    latest: Reading

    def __init__(self, read_state: Callable[[], tuple[Numbers, float]], dim: int) -> None:
        self._read_state, self._dim = read_state, dim

    def begin(self, pause: float) -> None:
        """Take two readings, ``pause`` seconds apart; the second one is the rollout's first.

        Raises RobotError if a reading is not a state, or the time stamp did not advance.
        """
        stale = self._read()
        time.sleep(pause)
        self._first = self._before = self.latest = self._read()
        if self.latest.stamp <= stale.stamp:
            raise RobotError(
                f"the robot's time stamps must advance, got {stale.stamp} s and {pause} s later "
                f"{self.latest.stamp} s"
            )

    def take(self) -> None:
        """Take the next reading. Raises RobotError if it is not a state."""
        self._before, self.latest = self.latest, self._read()

    def repeated(self) -> bool:
        """Whether the latest reading is no newer than the one before."""
        return self.latest.stamp <= self._before.stamp

    def age(self) -> float:
        """Seconds by which the latest reading was older at its arrival than the first one was."""
        passed = self.latest.taken - self._first.taken
        return passed - (self.latest.stamp - self._first.stamp)

    def _read(self) -> Reading:
        state, stamp = self._read_state()
        taken = time.monotonic()
        state = torch.as_tensor(state, dtype=torch.float64)
        if state.shape != (self._dim,) or not state.isfinite().all():
            raise RobotError(f"a reading must be {self._dim} finite numbers, got {state.tolist()}")
        return Reading(state.clone(), float(stamp), taken)
