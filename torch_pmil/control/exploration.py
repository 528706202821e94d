"""Exploration: how a robot moves before anything is learned, for the data of its first model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor, check_whole
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.state_box import StateBox
from torch_pmil.settings import Settings, setting

Feedforward = Callable[[Tensor], Tensor]

OF_STATE = "numbers, one for each entry of the state"
# of cautious motions
FIRST_AMPLITUDE = 1 / 16  # of a motion, with which each of its rollouts begins
GROWTH = 1.25  # of the amplitude with each step
KEPT = 0.75  # part of each margin at the start that must be left where the amplitude grows


class Motion(Protocol):
    """Actions at states, called once for each control step; ``amplitude`` from 0 to 1 scales it."""

    amplitude: float

    def begin(self) -> None:
        """Start a new rollout."""

    def __call__(self, state: Tensor) -> Tensor:
        """Actions of the next step, (*batch, F), at states (*batch, D)."""


class Exploration(Protocol):
    """How a robot explores: number and length of rollouts, and motion."""

    @property
    def rollouts(self) -> int:
        """Number of rollouts."""

    @property
    def steps(self) -> int:
        """Control steps of each rollout."""

    @property
    def settings(self) -> dict[str, object]:
        """Numbers on which a run depends, in types that JSON has."""

    def motion(self, generator: torch.Generator) -> Motion:
        """Motion of the robot, which draws from a generator."""


@dataclass(frozen=True, eq=False)
class RandomActions:
    """Rollouts of independent actions, uniform around one of them, within the robot's range.

    Args:
        actions: the robot's actions.
        fraction: largest distance from that action, as a fraction of half the range; actions are
            clipped to the range.
        steps, rollouts: control steps of each rollout, and number of rollouts.
        around: that action, (F,), or one for each step, (steps, F); None for the middle.
        hold: control steps for which each action stays.

    Raises:
        ValueError: the fraction is not in (0, 1], or another number or shape does not fit.

    Example:
        >>> low, high = torch.tensor([-4.0, -3.0]), torch.tensor([4.0, 3.0])
        >>> targets = ActionSpace(("q1", "q2"), ("rad", "rad"), low, high)
        >>> random = RandomActions(targets, 0.1, steps=25, around=torch.tensor([3.9, 0.0]))
        >>> drawn = random.motion(torch.Generator().manual_seed(0))(torch.zeros(1000, 4))
        >>> drawn.amax(0).round(decimals=1)
        tensor([4.0000, 0.3000], dtype=torch.float64)
    """

    actions: ActionSpace
    fraction: float
    steps: int
    rollouts: int = 1
    around: Tensor | None = None
    hold: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.fraction <= 1:
            raise ValueError(f"fraction must be above 0 and at most 1, got {self.fraction}")
        for name in ("steps", "rollouts", "hold"):
            object.__setattr__(self, name, check_whole(name, getattr(self, name), 1))
        if self.around is not None:
            each = (self.steps,) if self.around.ndim > 1 else ()
            check_tensor("around", self.around, (*each, len(self.actions.names)))

    @property
    def settings(self) -> dict[str, object]:
        """Numbers on which a run depends, in types that JSON has."""
        counts: dict[str, object] = {"rollouts": self.rollouts, "steps": self.steps}
        numbers = counts | {"random_action": self.fraction}
        return numbers if self.around is None else numbers | {"around": self.around.tolist()}

    def motion(self, generator: torch.Generator) -> Motion:
        """Motion of independent actions, drawn from a generator."""
        return _Uniform(self, generator)


class _Stepwise:
    amplitude = 1.0

    def begin(self) -> None:
        """Start a new rollout."""
        self.step = 0


class _Uniform(_Stepwise):
    def __init__(self, random: RandomActions, generator: torch.Generator) -> None:
        actions = random.actions
        self.low, self.high = actions.low.double(), actions.high.double()
        around = (actions.middle if random.around is None else random.around).double()
        self.around = around.expand(random.steps, -1)
        self.reach, self.generator = random.fraction * actions.half_range.double(), generator
        self.hold = random.hold
        self.begin()

    def __call__(self, state: Tensor) -> Tensor:
        if self.step % self.hold == 0:
            shape = (*state.shape[:-1], len(self.reach))
            uniform = torch.rand(shape, dtype=torch.float64, generator=self.generator)
            self.offset = self.reach * (2 * uniform - 1)
        around = self.around[self.step % len(self.around)]
        self.step += 1
        return (around + self.amplitude * self.offset).clamp(self.low, self.high)


@dataclass(frozen=True, eq=False)
class PDMovements(Settings):
    r"""Simple movements of a PD controller around a pose (Section 5.2.4).

    .. math:: u = \operatorname{clip}_{\pm u_{\max}}\left(u_{\mathrm{ff}}(x) + K (x^* - x)\right)

    The target :math:`x^*` is drawn uniformly around the pose, and anew every ``hold`` steps.

    Args:
        pose: state (D,) around which the robot moves.
        reach: largest distances (D,) of a target from the pose, in its units; 0 for velocities.
        gain: K (F, D): stiffness (N·m/rad) of positions, damping (N·m·s/rad) of velocities.
        u_max: torque limits (F,), N·m.
        hold: control steps for which a target stays.
        rollouts, steps: number of rollouts, and control steps of each.
        feedforward: torques (*batch, F) at states (*batch, D), which carry the robot's weight.

    Raises:
        ValueError: shapes do not fit each other, or a number is out of range.

    Example:
        >>> still, gain = torch.zeros(2), torch.tensor([[5.0, 1.0]])
        >>> reach, u_max = torch.tensor([0.4, 0.0]), torch.tensor([3.0])
        >>> pd = PDMovements(still, reach, gain, u_max, 5, 3, 20, lambda state: state[..., :1])
        >>> pd.motion(torch.Generator().manual_seed(0))(still).abs().item() <= 5 * 0.4
        True
    """

    prefix: ClassVar[str] = "exploration."

    pose: Tensor = setting(
        ..., "state around which the robot moves", words=OF_STATE, unit="rad, rad/s"
    )
    reach: Tensor = setting(
        ...,
        "largest distances of the targets from that state",
        words=OF_STATE,
        least=0,
        unit="rad, rad/s",
    )
    gain: Tensor = setting(
        ...,
        "stiffness and damping of the controller",
        words="a row of numbers for each torque, one for each entry of the state",
        unit="N·m/rad, N·m·s/rad",
    )
    u_max: Tensor  # type: ignore[misc]  # those before it have no default
    hold: int = setting(..., "time for which a target stays", least=1, unit="control steps")
    rollouts: int = setting(..., "movements of the first motion", least=1, unit="rollouts")
    steps: int = setting(..., "length of each movement", least=1, unit="control steps")
    feedforward: Feedforward  # type: ignore[misc]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tensor("exploration.pose", self.pose, ("D",))
        D, F = len(self.pose), len(self.u_max)
        for name, shape in (("reach", (D,)), ("gain", (F, D))):
            check_tensor(f"exploration.{name}", getattr(self, name), shape)
        check_tensor("u_max", self.u_max, (F,))
        if not (self.u_max > 0).all():
            raise ValueError(f"u_max must be positive, got {self.u_max.tolist()}")

    @property
    def settings(self) -> dict[str, object]:
        """Numbers on which a run depends, in types that JSON has."""
        return {name.removeprefix(self.prefix): value for name, value in self.adjustable.items()}

    def motion(self, generator: torch.Generator) -> Motion:
        """Motion of the PD controller, with targets drawn from a generator."""
        return _PDControl(self, generator)


class _PDControl(_Stepwise):
    def __init__(self, movements: PDMovements, generator: torch.Generator) -> None:
        self.movements, self.generator = movements, generator
        self.begin()

    def __call__(self, state: Tensor) -> Tensor:
        movements, state = self.movements, state.double()
        if self.step % movements.hold == 0:
            offset = 2 * torch.rand(state.shape, dtype=torch.float64, generator=self.generator) - 1
            self.target = movements.pose + self.amplitude * movements.reach * offset
        self.step += 1
        torque = movements.feedforward(state) + (self.target - state) @ movements.gain.double().mT
        return torque.clamp(-movements.u_max, movements.u_max)


class CautiousMotion:
    """A motion whose amplitude depends on how near the robot is to the limits of a box.

    Each rollout begins with a sixteenth of the amplitude. It grows by a quarter at each step where
    every margin is at least three quarters of that at the start, and is halved at all others. This
    is not a guarantee: the box's guard stops a rollout that leaves nevertheless.

    Args:
        motion: the motion, whose amplitude is set.
        box: limits of the state.

    Example:
        >>> from torch_pmil.control.state_space import StateSpace, joint_match
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
        """Start a new rollout."""
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
