"""Deadlines one control period apart, on the monotonic clock."""

from __future__ import annotations

import time


class ControlClock:
    """Deadlines that do not drift: each is one period after the one before.

    Args:
        period: seconds between two deadlines.

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
        """Let the deadlines count from now on."""
        self._deadline = time.monotonic()

    def wait(self) -> None:
        """Sleep until the next deadline, or not at all where it has passed."""
        self._deadline += self.period
        time.sleep(max(0.0, self._deadline - time.monotonic()))

    def lag(self) -> float:
        """Seconds since the last deadline that was waited for."""
        return time.monotonic() - self._deadline
