"""A robot that stops on every way out."""

from __future__ import annotations

import gc
import logging
import math
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable
from types import FrameType

from torch import Tensor

from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers, PhysicalRobot
from torch_pmil.envs.physical.robot_checks import finite_vector
from torch_pmil.files import bounded_line

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)
LONGEST_STOP = 1.0  # s for which a signal waits for the robot's stop


class WatchedRobot:
    """A robot that stops when no action came for a time, and when the process is asked to end.

    A stopped robot takes no action before the next :meth:`start`. Nothing here runs after a
    ``kill -9``: against that the robot needs a watchdog of its own. While the robot moves, Python
    collects no garbage, since a collection can take more than a tenth of a second. A fork of the
    process does nothing to the robot.

    Args:
        robot: to be watched.
        patience: seconds between two actions after which it is stopped.
    """

    def __init__(self, robot: PhysicalRobot, patience: float) -> None:
        self._robot, self._owner, self._closed = robot, os.getpid(), False
        self._stopped, self._trouble, self._collects = "before it was started", "", False
        late = f"as no action came within {patience:g} s"
        self._watchdog = Watchdog(patience, lambda: self.stop(late))
        self._signals = StopSignals(lambda name: self.stop(f"at {name}"))

    def check_ready(self) -> None:
        """Raise RobotError if the robot must not be moved from here."""
        if os.getpid() != self._owner:
            raise RobotError(f"the robot belongs to process {self._owner}, not to a fork of it")
        if self._closed:
            raise RobotError("the environment of the robot is closed: make a new one")
        if self._trouble:
            raise RobotError(f"the robot could not be stopped: {self._trouble}")

    def start(self) -> None:
        """Let actions through from now on."""
        self._stopped, self._collects = "", gc.isenabled()
        gc.disable()

    def read_state(self) -> tuple[Numbers, float]:
        """State and time stamp of the robot."""
        return self._robot.read_state()

    def send(self, action: Tensor) -> Tensor:
        """Send an action (F,); return what the robot took.

        Raises RobotError if the robot was stopped, or returns something else than an action.
        """
        self.check_ready()
        self._check_started()
        self._watchdog.feed()
        sent = self._robot.send(action.clone())  # which the robot may write into
        try:
            self._check_started()
        except RobotError:
            self._robot.stop()  # the stop may have come before the action
            raise
        try:
            return action if sent is None else finite_vector("what send returns", sent, len(action))
        except ValueError as error:
            raise RobotError(str(error)) from error

    def stop(self, reason: str = "by the program") -> None:
        """Stop the robot. A failure is logged, because nothing else can be done about it."""
        if self._closed or os.getpid() != self._owner:
            return
        self._stopped = self._stopped or reason
        self._watchdog.rest()
        try:
            self._robot.stop()
            self._trouble = ""
        except Exception as error:
            self._trouble = bounded_line(f"{type(error).__name__}: {error}")
            logging.getLogger(__name__).error("the robot could not be stopped: %s", self._trouble)
        finally:
            if self._collects:
                gc.enable()

    def close(self) -> None:
        """Stop the robot if it moves, and end the watch."""
        if os.getpid() != self._owner:
            return
        if not self._stopped or self._trouble:
            self.stop()
        self._closed = True
        self._watchdog.close()
        self._signals.close()

    def _check_started(self) -> None:
        if self._stopped:
            raise RobotError(f"the robot was stopped, {self._stopped}")


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


class StopHangs(BaseException):
    """Ends a stop that does not return, so that the signal that asked for it takes effect."""


class StopSignals:
    """Calls ``stop`` with the name of a signal, and then the handler that was there before.

    The signals are those of Ctrl-C, Ctrl-\\ and Ctrl-Z, SIGTERM and SIGHUP. A stop that takes
    longer than ``LONGEST_STOP`` is ended, also by a second signal. Handlers belong to the main
    thread; in any other thread this class only warns. A signal that the process ignores stays
    ignored.
    """

    def __init__(self, stop: Callable[[str], None]) -> None:
        self._stop, self._before = stop, dict[int, Callable | int | None]()
        self._number: int | None = None  # of the signal whose stop has not returned
        if threading.current_thread() is not threading.main_thread():
            warnings.warn(
                "signals such as Ctrl-C and SIGTERM will not stop the robot: its environment must "
                "be made in the main thread",
                RuntimeWarning,
                stacklevel=2,
            )
            return
        self._limit = Watchdog(LONGEST_STOP, self._give_up)
        for number in SIGNALS:
            handler = signal.getsignal(number)
            if handler not in (signal.SIG_IGN, None):
                self._before[number] = handler
                signal.signal(number, self._heard)

    def close(self) -> None:
        """Restore the earlier handlers, unless others were set since."""
        if self._before and threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if signal.getsignal(number) == self._heard:
                    signal.signal(number, handler)
            self._limit.close()

    def _heard(self, number: int, frame: FrameType | None) -> None:
        hangs, self._number = self._number is not None, number
        if hangs:
            raise StopHangs  # out of the stop below
        try:
            self._limit.feed()
            self._stop(signal.Signals(number).name)
        except StopHangs:
            message = "the robot could not be stopped: its stop did not return"
            logging.getLogger(__name__).error(message)
        finally:
            self._limit.rest()
            number, self._number = self._number, None
        self._pass_on(number, frame)

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        handler = self._before[number]
        if callable(handler):
            handler(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
            signal.signal(number, self._heard)  # after Ctrl-Z the process may go on

    def _give_up(self) -> None:
        """Interrupt the main thread in its stop, by the same signal."""
        number, thread = self._number, threading.main_thread().ident
        if number is not None and thread is not None:
            signal.pthread_kill(thread, number)
