"""The samplings of one's own robot, among which a run chooses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch_pmil.checks import plain, whole_multiple
from torch_pmil.control.exploration import RandomActions
from torch_pmil.envs.rollouts import OfStates
from torch_pmil.files import short
from torch_pmil.model.past_evidence import FARTHEST
from torch_pmil.tasks.deviation import Deviation
from torch_pmil.tasks.sampling import Sampling
from torch_pmil.tasks.task import Task

FEWEST = 25  # steps of a motion at the longest step
# past entries and actions, fewest first
PASTS = ((0, 0), *((0, periods) for periods in range(1, FARTHEST + 1)), (1, 1))


def samplings_of(task: Task, given: Sampling, step: object, past: object) -> tuple[Sampling, ...]:
    """Samplings of a task; the first is used for a robot for which a run chooses nothing.

    Args:
        task: of the robot at its own rate.
        given: what is said about the past.
        step, past: arguments of :func:`~torch_pmil.tasks.own_robot.own_robot`.

    Raises:
        ValueError: an argument is of another kind, or the step is not a multiple of the period.
    """
    if past not in ("auto", None):
        raise ValueError(f'past must be "auto" or None, got {short(past)}')
    steps = _steps(task) if step == "auto" else [_periods(task, step)]
    pasts = [given]
    movable = isinstance(task.exploration, RandomActions)
    if past == "auto" and not given.past and movable:
        pasts = [Sampling(1, *each) for each in PASTS]
    return tuple(replace(each, held=held) for held in steps for each in pasts)


def _steps(task: Task) -> list[int]:
    """Powers of two, in control periods, which leave a motion enough steps."""
    error = task.error.of_states if isinstance(task.error, OfStates) else None
    if not isinstance(error, Deviation) or not isinstance(task.exploration, RandomActions):
        return [1]
    return [2**power for power in range(max(1, (task.horizon // FEWEST).bit_length()))]


def _periods(task: Task, step: Any) -> int:
    """A step in control periods."""
    period, step = task.time_step, plain(step)
    number = isinstance(step, int | float) and not isinstance(step, bool)
    periods = whole_multiple(step, period) if number else None
    if periods is None:
        raise ValueError(
            f'step must be "auto" or seconds, a multiple of control_period = {period:g} s, got '
            f"{short(step)}"
        )
    return periods
