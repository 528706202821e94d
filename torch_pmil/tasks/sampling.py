"""How a robot is sampled: the length of a step, and how much of the past its state holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch_pmil.checks import plain


@dataclass(frozen=True)
class Sampling:
    """How model and policy see and move a robot.

    Args:
        held: control periods of the robot for which an action is held.
        past_entries, past_actions, positions_only: what the state holds of the past, see
            :func:`~torch_pmil.tasks.with_history.with_history`.
    """

    held: int = 1
    past_entries: int = 0
    past_actions: int = 0
    positions_only: bool = False

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, plain(value))

    @property
    def past(self) -> dict[str, Any]:
        """What the state holds of the past, if it holds any."""
        names = ("past_actions", "past_entries", "positions_only")
        return {name: value for name in names if (value := getattr(self, name))}

    def described(self, period: float) -> str:
        """The step, for a robot with this control period (s), and the past.

        Example:
            >>> Sampling(held=2, past_actions=1).described(0.05)
            'steps of 0.1 s, past_actions=1'
        """
        past = [f"{name}={value}" for name, value in self.past.items()]
        return ", ".join([f"steps of {self.held * period:g} s", *past])
