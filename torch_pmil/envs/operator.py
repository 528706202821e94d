"""What may end a rollout from outside: the operator of a robot, or the robot itself."""

from __future__ import annotations


class RunStopped(Exception):
    """The operator ended the run: what was recorded is kept, and ``resume`` goes on."""


class RolloutDiscarded(Exception):
    """The operator discarded the last rollout: it leaves the data."""


class RobotError(RuntimeError):
    """The robot cannot be reached: what was recorded is kept, and ``resume`` goes on."""
