"""Exploration within a box: the first motion grows from small while it keeps far from limits."""

from __future__ import annotations

from torch import Tensor

from torch_pmil.control.exploration import Motion
from torch_pmil.control.state_box import StateBox

FIRST_AMPLITUDE = 1 / 16  # of a motion, with which each of its rollouts begins
GROWTH = 1.25  # of the amplitude with each step
KEPT = 0.75  # part of each margin at the start that must be left where the amplitude grows


class CautiousMotion:
    """A motion whose amplitude depends on how near the robot is to the limits of a box.

    Before anything is learned, nothing is known but the limits and the state. So each rollout
    begins with a sixteenth of the amplitude, which grows by a quarter with each step at which three
    quarters of all margins of the start are left, up to the whole one, and is halved at all others.
    That is no guarantee: the box's guard stops a rollout that leaves nevertheless.

    Args:
        motion: the motion, whose amplitude is set.
        box: limits of the state.

    Example:
        >>> from torch_pmil.control.action_space import ActionSpace
        >>> from torch_pmil.control.exploration import RandomActions
        >>> from torch_pmil.control.state_space import StateSpace, joint_match
        >>> import torch
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> motors = ActionSpace(("tau",), ("N·m",), -torch.ones(1), torch.ones(1))
        >>> motion = RandomActions(motors, 0.4, 25).motion(torch.Generator().manual_seed(0))
        >>> cautious = CautiousMotion(motion, StateBox(space, {"q": (-1.0, 1.0)}))
        >>> cautious.begin()
        >>> for q in (0.0, 0.1, 0.2, 0.5):
        ...     action = cautious(torch.tensor([q]))
        ...     print(cautious.amplitude)
        0.0625
        0.078125
        0.09765625
        0.048828125
    """

    def __init__(self, motion: Motion, box: StateBox) -> None:
        self.motion, self.box = motion, box
        self.begin()

    def begin(self) -> None:
        """Start a new rollout, with a small amplitude."""
        self.motion.begin()
        self.amplitude = FIRST_AMPLITUDE
        self._at_start: Tensor | None = None

    def __call__(self, state: Tensor) -> Tensor:
        """Actions of the next step, (*batch, F), at states (*batch, D)."""
        margins = self.box.margins(state)
        if self._at_start is None:
            self._at_start = margins.clamp(min=0)
        elif (margins >= KEPT * self._at_start).all():
            self.amplitude = min(GROWTH * self.amplitude, 1.0)
        else:
            self.amplitude /= 2
        self.motion.amplitude = self.amplitude
        return self.motion(state)
