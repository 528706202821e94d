"""A physical robot in real time, as a TorchRL environment."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Unbounded

from torch_pmil.checks import check_positive, check_whole
from torch_pmil.envs.operator import RobotError, prompt
from torch_pmil.envs.physical.physical_robot import Numbers, PhysicalRobot
from torch_pmil.envs.physical.readings import ControlClock, Readings
from torch_pmil.envs.physical.robot_checks import check_robot, finite_vector
from torch_pmil.envs.physical.watched_robot import WatchedRobot
from torch_pmil.envs.robot import RobotEnv
from torch_pmil.envs.turning import Continued
from torch_pmil.files import bounded_line

PATIENCE = 2  # control periods without an action after which the robot is stopped


class PhysicalRobotEnv(RobotEnv):
    """A robot that moves in real time while the program computes.

    A reset asks the operator to put the robot at its start, and reads the state. A step sends the
    action at once, waits for the deadline, one control period after the one before, and reads the
    state again.

    A step is late if the robot repeats a time stamp, or if one of these is off by more than
    ``tolerance`` of a period: the time from a reading to the action that answers it, the time from
    the deadline to the reading, the age of the reading compared with the newest one so far, or a
    time stamp that runs ahead. The model learns from late steps too, although their action was not
    held for exactly one period.
    After ``most_late`` late steps in a row the rollout ends. A reading that fails, or whose state
    or time stamp is not finite, also ends it. ``cut_short`` then gives the reason.

    The robot stops when a rollout ends early, at an exception, Ctrl-C, Ctrl-\\, Ctrl-Z, SIGTERM,
    SIGHUP, ``close`` and the end of the program, and when no action came within two periods, which
    includes the end of a rollout. Against ``kill -9`` it needs a watchdog of its own. Signals stop
    it only if the environment was made in the main thread; elsewhere a RuntimeWarning says so. A
    fork of the process neither moves nor stops the robot.

    Keys, besides those of every robot, float64 unless stated: ``"time"`` (1,), the time stamp of
    the reading in s; ``"delay"`` (1,), seconds from the reading before to the sending of the
    action; ``"overrun"`` (1,), seconds from the deadline to the reading; ``"late"`` (1,), bool;
    ``"measured"`` (1,), bool, False if the reading failed and the observation is an old one;
    ``"sent"`` (F,), the action that the robot took.

    Args:
        robot: the robot.
        dim: entries D of its state.
        low, high: smallest and largest actions, length F; actions are clipped to them.
        control_period: seconds between two actions.
        action_names: of the F actions; None for their numbers.
        action_units: of the F actions; None if unknown.
        operator: called before each rollout; it may raise what
            :func:`torch_pmil.envs.operator.prompt` raises.
        largest_change: largest change of each action from the one before, length F; None for any.
        holding_action: action (F,) with which the robot rests in a state (D,). The first action of
            a rollout changes from it; needed with ``largest_change``.
        tolerance: share of the period by which a step may be off before it is late.
        most_late: late steps in a row that end a rollout.

    Raises:
        ValueError: a setting has the wrong shape or range.
        TypeError: the robot lacks a method, or a setting that must be a function is not one.
        RobotError: at a reset, if the robot cannot be read or stopped.

    Example:
        >>> class Cart:
        ...     def read_state(self):
        ...         return [0.0, 0.0], time.monotonic()
        ...
        ...     def send(self, action):
        ...         pass
        ...
        ...     def stop(self):
        ...         pass
        >>> env = PhysicalRobotEnv(
        ...     Cart(), dim=2, low=[-1.0], high=[1.0], control_period=0.1, operator=lambda: None
        ... )
        >>> env.rollout(3)["next", "measured"].all()
        tensor(True)
        >>> env.close()
    """

    physical = True

    def __init__(
        self,
        robot: PhysicalRobot,
        *,
        dim: int,
        low: Numbers,
        high: Numbers,
        control_period: float,
        action_names: Sequence[str] | None = None,
        action_units: Sequence[str] | None = None,
        operator: Callable[[], None] = prompt,
        largest_change: Numbers | None = None,
        holding_action: Callable[[Tensor], Tensor] | None = None,
        tolerance: float = 0.25,
        most_late: int = 3,
    ) -> None:
        check_robot(robot)
        check_whole("dim", dim, 1)
        check_whole("most_late", most_late, 1)
        control_period = check_positive("control_period", control_period)
        tolerance = check_positive("tolerance", tolerance)
        if not callable(operator) or not (holding_action is None or callable(holding_action)):
            raise TypeError(
                f"operator and holding_action must be functions, got {operator!r} and "
                f"{holding_action!r}"
            )
        super().__init__((), control_period, from_pixels=False, seed=None)
        self.operator, self.holding_action = operator, holding_action
        self.tolerance, self.most_late = tolerance, most_late
        low, high = finite_vector("low", low), finite_vector("high", high)
        if low.shape != high.shape or not (low < high).all():
            raise ValueError(f"low must be below high, got {low.tolist()} and {high.tolist()}")
        self._names = _named("action_names", action_names, len(low))
        self._units = _named("action_units", action_units, len(low))
        self._largest_change = _changes(largest_change, holding_action, len(low))
        self._make_specs(dim, low, high)
        self._clock = ControlClock(control_period)
        self._robot = WatchedRobot(robot, PATIENCE * control_period)
        self._readings = Readings(self._robot.read_state, dim)
        self._finalizer = weakref.finalize(self, self._robot.close)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions, or else their numbers."""
        return self._names or super().action_names

    @property
    def action_units(self) -> tuple[str, ...]:
        """Units of the actions, "" if unknown."""
        return self._units or super().action_units

    def close(self, **kwargs: Any) -> None:
        """Stop the robot and end the watch."""
        self._finalizer()
        super().close(**kwargs)

    def _make_specs(self, dim: int, low: Tensor, high: Tensor) -> None:
        seconds = dict.fromkeys(("time", "delay", "overrun"), Unbounded((1,), dtype=torch.float64))
        flags = dict.fromkeys(("late", "measured"), Binary(1, dtype=torch.bool))
        sent = Unbounded(low.shape, dtype=torch.float64)
        self._set_specs(dim, low, high, {**seconds, **flags, "sent": sent})

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        self._robot.stop()
        self._robot.check_ready()
        self.operator()
        self.cut_short, self._late_in_a_row = "", 0
        try:
            self._readings.begin(self.control_period)
        except Exception as error:
            raise RobotError(_failure(error)) from error
        self._sent = torch.zeros_like(self.action_spec.space.low)
        if self.holding_action is not None:
            held = self.holding_action(self._readings.latest.state.clone())
            self._sent = finite_vector("holding_action", held, len(self._sent))
        self._clock.start()
        self._robot.start()
        self._continued = Continued(self.turning_entries)
        return self._shown(_Timing())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        try:
            timing, trouble = self._moved(self._limited(tensordict["action"]))
            result = self._without_reward(self._shown(timing))
            if trouble:
                self.cut_short = trouble
                result["done"] = torch.ones(1, dtype=torch.bool)
        except BaseException:
            self._robot.stop()
            raise
        if result["done"]:
            self._robot.stop()
        return result

    def _limited(self, action: Tensor) -> Tensor:
        """The action within the limits."""
        limits = self.action_spec.space
        if action.shape != limits.low.shape or not action.isfinite().all():
            raise ValueError(f"action must be {len(limits.low)} finite numbers, got {action}")
        action = action.detach().to(torch.float64)
        if self._largest_change is not None:
            change = self._largest_change
            action = action.clamp(self._sent - change, self._sent + change)
        return action.clamp(limits.low, limits.high)

    def _moved(self, action: Tensor) -> tuple[_Timing, str]:
        """Send, wait and read; return the timing, and why the rollout must end, if it must."""
        delay = time.monotonic() - self._readings.latest.taken
        if self._clock.lag() > self._slack:
            self._clock.start()  # the period of an action that comes late counts from its sending
        try:
            self._sent = self._robot.send(action)
            self._clock.wait()
            self._readings.take()
        except Exception as error:  # each robot fails with errors of its own
            return _Timing(delay, measured=False), _failure(error)
        overrun = self._clock.lag()
        reason = self._lateness(delay, overrun)
        self._late_in_a_row = self._late_in_a_row + 1 if reason else 0
        trouble = ""
        if self._late_in_a_row >= self.most_late:
            trouble = f"{self._late_in_a_row} steps in a row were late; the last one: {reason}"
        return _Timing(delay, overrun, bool(reason)), trouble

    @property
    def _slack(self) -> float:
        return self.tolerance * self.control_period

    def _lateness(self, delay: float, overrun: float) -> str:
        """Why a step is late, or ""."""
        if self._readings.repeated():
            return f"the robot repeats the reading of {self._readings.latest.stamp:.3f} s"
        if self._readings.jump() > self._slack:
            return f"its time stamp ran ahead by {self._readings.jump():.3f} s"
        if self._readings.age() > self._slack:
            return f"its reading was {self._readings.age():.3f} s old"
        if overrun > self._slack:
            return f"its reading came {overrun:.3f} s after the deadline"
        if delay > self._slack:
            return f"its action was sent {delay:.3f} s after the reading"
        return ""

    def _shown(self, timing: _Timing) -> TensorDict:
        shown = {
            "time": self._readings.latest.stamp,
            "delay": timing.delay,
            "overrun": timing.overrun,
            "late": timing.late,
            "measured": timing.measured,
        }
        entries = {
            key: torch.tensor([value], dtype=self.observation_spec[key].dtype)
            for key, value in shown.items()
        }
        return TensorDict(
            {
                "observation": self._continued(self._readings.latest.state),
                "sent": self._sent,
                **entries,
            }
        )


@dataclass(frozen=True)
class _Timing:
    delay: float = 0.0  # s
    overrun: float = 0.0  # s
    late: bool = False
    measured: bool = True


def _failure(error: Exception) -> str:
    """The robot's own error in one line."""
    if isinstance(error, RobotError):
        return bounded_line(error)
    return bounded_line(f"the robot failed with {type(error).__name__}: {error}")


def _named(name: str, words: Sequence[str] | None, count: int) -> tuple[str, ...]:
    given = () if words is None else (words,) if isinstance(words, str) else tuple(words)
    if words is not None and (isinstance(words, str) or len(given) != count):
        raise ValueError(
            f"{name} must be {count} words, got {', '.join(map(str, given)) or 'none'}"
        )
    return given


def _changes(
    values: Numbers | None, holding_action: Callable[[Tensor], Tensor] | None, count: int
) -> Tensor | None:
    if values is None:
        return None
    changes = finite_vector("largest_change", values, count)
    if not (changes > 0).all():
        raise ValueError(f"largest_change must be {count} positive numbers, got {changes.tolist()}")
    if holding_action is None:
        raise ValueError("largest_change needs holding_action, from which the first one changes")
    return changes
