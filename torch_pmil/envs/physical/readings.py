"""Deadlines and readings of one rollout, and how old the readings are."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers
from torch_pmil.envs.physical.robot_checks import finite_vector

UNIT = 10  # factor by which the first time stamps may seem to pass faster or slower than seconds


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

    @property
    def lead(self) -> float:
        """Seconds by which the robot's clock is ahead of ours, less the age of the reading."""
        return self.stamp - self.taken


class Readings:
    """The readings of a rollout, and how old they are.

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

        Raises RobotError if a reading is not a state, or the time stamps do not advance in seconds.
        """
        stale = self._read()
        time.sleep(pause)
        first = self._before = self.latest = self._read()
        stamps = f"got {stale.stamp} s and {pause} s later {first.stamp} s"
        advance, passed = first.stamp - stale.stamp, first.taken - stale.taken
        if advance <= 0:
            raise RobotError(f"the robot's time stamps must advance, {stamps}")
        if not passed / UNIT <= advance <= passed * UNIT:
            raise RobotError(f"the robot's time stamps must be in seconds, {stamps}")
        self._lead = self._lead_before = first.lead

    def take(self) -> None:
        """Take the next reading. Raises RobotError if it is not a state."""
        self._before, self.latest = self.latest, self._read()
        self._lead_before, self._lead = self._lead, max(self._lead, self.latest.lead)

    def repeated(self) -> bool:
        """Whether the latest reading is no newer than the one before."""
        return self.latest.stamp <= self._before.stamp

    def age(self) -> float:
        """Seconds by which the latest reading was older at its arrival than the newest so far."""
        return self._lead - self.latest.lead

    def jump(self) -> float:
        """Seconds by which the latest time stamp is ahead of all before it."""
        return self._lead - self._lead_before

    def _read(self) -> Reading:
        reading = self._read_state()
        taken = time.monotonic()
        if not isinstance(reading, tuple | list) or len(reading) != 2:
            raise RobotError(f"read_state must return a state and its time, got {reading!r:.200}")
        state, stamp = reading
        try:
            return Reading(finite_vector("a reading", state, self._dim), _seconds(stamp), taken)
        except ValueError as error:
            raise RobotError(str(error)) from error


def _seconds(stamp: object) -> float:
    try:
        seconds = float(stamp)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError, RuntimeError):
        seconds = math.nan
    if not math.isfinite(seconds):
        raise ValueError(f"a time stamp must be a finite number of seconds, got {stamp!r:.200}")
    return seconds
