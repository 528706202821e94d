"""A robot that stops on every way out."""

from __future__ import annotations

import gc
import logging
import math
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers, PhysicalRobot

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class WatchedRobot:
    """A robot that stops when no action came for a time, and when the process is asked to end.

    A stopped robot takes no action before the next :meth:`start`. Nothing here runs after a
    ``kill -9``: against that the robot needs a watchdog of its own. While the robot moves, Python
    collects no garbage, since a collection can take more than a tenth of a second.

    Args:
        robot: to be watched.
        patience: seconds between two actions after which it is stopped.
    """

    def __init__(self, robot: PhysicalRobot, patience: float) -> None:
        self._robot, self._stopped, self._collects = robot, True, False
        self._watchdog = Watchdog(patience, self.stop)
        self._signals = StopSignals(self.stop)

    def start(self) -> None:
        """Let actions through from now on."""
        self._stopped, self._collects = False, gc.isenabled()
        gc.disable()

    def read_state(self) -> tuple[Numbers, float]:
        """State and time stamp of the robot."""
        return self._robot.read_state()

    def send(self, action: Numbers) -> Numbers | None:
        """Send an action. Raises RobotError if the robot was stopped."""
        self._check_started()
        self._watchdog.feed()
        sent = self._robot.send(action)
        try:
            self._check_started()
        except RobotError:
            self._robot.stop()  # the stop may have come before the action
            raise
        return sent

    def stop(self) -> None:
        """Stop the robot. A failure is logged, because nothing else can be done about it."""
        self._stopped = True
        self._watchdog.rest()
        try:
            self._robot.stop()
        except Exception as error:
            logging.getLogger(__name__).error("the robot could not be stopped: %s", error)
        if self._collects:
            gc.enable()

    def close(self) -> None:
        """Stop the robot if it moves, and end the watch."""
        if not self._stopped:
            self.stop()
        self._watchdog.close()
        self._signals.close()

    def _check_started(self) -> None:
        if self._stopped:
            raise RobotError(
                f"the robot was stopped, as no action came within {self._watchdog.patience:g} s"
            )


class Watchdog:
    """Calls ``alarm``, in its own thread, when it was not fed for ``patience`` seconds.

    The time runs from the first :meth:`feed`, and after an alarm from the next one.

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
        """Restart the time."""
        with self._changed:
            asleep, self._deadline = self._deadline == math.inf, time.monotonic() + self.patience
            if asleep:
                self._changed.notify()

    def rest(self) -> None:
        """Wait for the next :meth:`feed`. It takes no lock, so signal handlers may call it."""
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


class StopSignals:
    """Calls ``stop`` at Ctrl-C, SIGTERM and SIGHUP, and then the handler that was there before.

    Handlers belong to the main thread; in any other thread this class does nothing. A signal that
    the process ignores stays ignored.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._before = {}
        if threading.current_thread() is threading.main_thread():
            before = {number: signal.getsignal(number) for number in SIGNALS}
            self._before = {
                number: handler
                for number, handler in before.items()
                if handler not in (signal.SIG_IGN, None)
            }
        for number in self._before:
            signal.signal(number, self._heard)

    def close(self) -> None:
        """Restore the earlier handlers, unless others were set since."""
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if signal.getsignal(number) == self._heard:
                    signal.signal(number, handler)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        self._stop()
        handler = self._before[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
