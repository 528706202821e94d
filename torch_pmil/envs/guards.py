"""What ends a robot's motion: guards of its own, and those of the task that it learns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from torch_pmil.envs.robot import RobotEnv

Guard = Callable[[Tensor], str]  # of states (*batch, D): why the motion must end, or ""


@dataclass(frozen=True, eq=False)
class Guards:
    """The robot's own guard, and then those of a task.

    Example:
        >>> import torch
        >>> guard = Guards(lambda states: "", (lambda states: "too far",))
        >>> guard(torch.zeros(4))
        'too far'
    """

    own: Guard | None
    of_task: tuple[Guard, ...]

    def __call__(self, states: Tensor) -> str:
        """Why the first guard that objects ends the motion; "" if none does."""
        every = self.of_task if self.own is None else (self.own, *self.of_task)
        return next((why for guard in every if (why := guard(states))), "")


def set_guards(env: RobotEnv, *guards: Guard | None) -> None:
    """Set the guards of a task, beside the robot's own and in place of an earlier task's."""
    own = env.guard.own if isinstance(env.guard, Guards) else env.guard
    of_task = tuple(guard for guard in guards if guard is not None)
    env.guard = Guards(own, of_task) if of_task else own
