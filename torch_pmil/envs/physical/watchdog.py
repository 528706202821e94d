"""An alarm that goes off when nothing was heard for a time."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable


class Watchdog:
    """Calls ``alarm``, in a thread of its own, when it was not fed for ``patience`` seconds.

    It waits for its first meal, and after an alarm for the next one.

    Args:
        patience: seconds.
        alarm: called without arguments.

    Example:
        >>> barked = threading.Event()
        >>> dog = Watchdog(0.01, barked.set)
        >>> dog.feed()
        >>> barked.wait(1)
        True
        >>> dog.close()
    """

    def __init__(self, patience: float, alarm: Callable[[], None]) -> None:
        self.patience, self._alarm = patience, alarm
        self._deadline, self._closed = math.inf, False
        self._changed = threading.Condition()
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()

    def feed(self) -> None:
        """Start the time anew."""
        with self._changed:
            asleep, self._deadline = self._deadline == math.inf, time.monotonic() + self.patience
            if asleep:
                self._changed.notify()

    def rest(self) -> None:
        """Wait for the next meal. It takes no lock, so that handlers of signals may call it."""
        self._deadline = math.inf

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _watch(self) -> None:
        while self._waited():
            self._alarm()

    def _waited(self) -> bool:
        """Wait until the time is over; return whether to bark."""
        with self._changed:
            while not self._closed:
                left = self._deadline - time.monotonic()
                if left <= 0:
                    self._deadline = math.inf
                    return True
                self._changed.wait(None if left == math.inf else left)
        return False
