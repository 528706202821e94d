"""Time that passes only while somebody sleeps, so that a loaded machine makes nothing late."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import ModuleType

import pytest

from tests.helpers import fake_robot
from torch_pmil.envs.physical import physical_robot_env, readings, watched_robot

SEEING: tuple[ModuleType, ...] = (physical_robot_env, readings, watched_robot, fake_robot)


class VirtualTime:
    """In place of the module ``time``, with what physical robots use of it."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def virtual_time(monkeypatch: pytest.MonkeyPatch) -> VirtualTime:
    """The time of physical robots and of the fake one until the test ends."""
    clock = VirtualTime()
    for module in SEEING:
        monkeypatch.setattr(module, "time", clock)
    return clock


def wait_until(true: Callable[[], bool], patience: float = 30.0) -> None:
    """Sleep, in real time, until ``true()``; fail after ``patience`` seconds."""
    end = time.monotonic() + patience
    while not true():
        assert time.monotonic() < end, f"not so within {patience} s"
        time.sleep(0.005)
