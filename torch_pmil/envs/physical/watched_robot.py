"""A robot that stops on every way out."""

from __future__ import annotations

import gc
import logging

from torch_pmil.envs.operator import RobotError
from torch_pmil.envs.physical.physical_robot import Numbers, PhysicalRobot
from torch_pmil.envs.physical.stop_signals import StopSignals
from torch_pmil.envs.physical.watchdog import Watchdog


class WatchedRobot:
    """A robot that stops when no action came for a time, and when the process is told to end.

    Once stopped it takes no action before the next :meth:`start`. A ``kill -9`` leaves no time for
    a last word: against that the robot has a watchdog of its own. While the robot moves, Python
    collects no garbage, which takes it a tenth of a second and more.

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
        """State and time of the robot."""
        return self._robot.read_state()

    def send(self, action: Numbers) -> Numbers | None:
        """Send an action.

        Raises:
            RobotError: the robot was stopped.
        """
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
        """Stop the robot. A failure is logged: whoever stops a robot can do no more."""
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
