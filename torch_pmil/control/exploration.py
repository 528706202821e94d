"""Exploration: how a robot moves before anything is learned, for the data of its first model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from torch_pmil.checks import check_finite_entries, check_tensor, check_whole
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.settings import Settings, setting

Feedforward = Callable[[Tensor], Tensor]

OF_STATE = "numbers, one for each entry of the state"


class Motion(Protocol):
    """Actions (*batch, F) at states (*batch, D), called once for each control step.

    ``amplitude``, from 0 to 1, scales the motion around the action or the pose where it stays.
    """

    amplitude: float

    def begin(self) -> None:
        """Start a new rollout."""

    def __call__(self, state: Tensor) -> Tensor:
        """Actions of the next step, (*batch, F), at states (*batch, D)."""


class Exploration(Protocol):
    """An experiment's exploration: number and length of its rollouts, and the robot's motion."""

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
        fraction: how far they go from the action around which they are drawn, as a fraction of
            half the range; what would leave the range is clipped.
        steps: control steps of each rollout.
        rollouts: number of rollouts.
        around: the action around which they are drawn, (F,), or that of each step, (steps, F); None
            for the middle of the range.

    Raises:
        ValueError: the fraction is not in (0, 1], there is no step or no rollout, or an action is
            not finite or has another shape.

    Example:
        >>> low, high = torch.tensor([-4.0, -3.0]), torch.tensor([4.0, 3.0])
        >>> targets = ActionSpace(("q1", "q2"), ("rad", "rad"), low, high)
        >>> motion = RandomActions(targets, 0.1, steps=25, around=torch.tensor([3.9, 0.0]))
        >>> drawn = motion.motion(torch.Generator().manual_seed(0))(torch.zeros(1000, 4))
        >>> [(round(least, 1), round(most, 1)) for least, most in zip(drawn.amin(0).tolist(),
        ...                                                         drawn.amax(0).tolist())]
        [(3.5, 4.0), (-0.3, 0.3)]
    """

    actions: ActionSpace
    fraction: float
    steps: int
    rollouts: int = 1
    around: Tensor | None = None

    def __post_init__(self) -> None:
        if not 0 < self.fraction <= 1:
            raise ValueError(f"fraction must be above 0 and at most 1, got {self.fraction}")
        check_whole("steps", self.steps, 1)
        check_whole("rollouts", self.rollouts, 1)
        if self.around is not None:
            each = (self.steps,) if self.around.ndim > 1 else ()
            check_tensor("around", self.around, (*each, len(self.actions.names)))

    @property
    def settings(self) -> dict[str, object]:
        """Number and length of the rollouts, the fraction, and the action if one is given."""
        numbers: dict[str, object] = {
            "rollouts": self.rollouts,
            "steps": self.steps,
            "random_action": self.fraction,
        }
        return numbers if self.around is None else numbers | {"around": self.around.tolist()}

    def motion(self, generator: torch.Generator) -> Motion:
        """Motion of independent actions, drawn from a generator."""
        return _Uniform(self, generator)


class _Uniform:
    amplitude = 1.0

    def __init__(self, random: RandomActions, generator: torch.Generator) -> None:
        actions = random.actions
        self.low, self.high = actions.low.double(), actions.high.double()
        around = (actions.middle if random.around is None else random.around).double()
        self.around = around.expand(random.steps, -1)
        self.reach, self.generator = random.fraction * actions.half_range.double(), generator
        self.begin()

    def begin(self) -> None:
        """Start a new rollout, with the first step."""
        self.step = 0

    def __call__(self, state: Tensor) -> Tensor:
        shape = (*state.shape[:-1], len(self.reach))
        uniform = torch.rand(shape, dtype=torch.float64, generator=self.generator)
        offset = self.amplitude * self.reach * (2 * uniform - 1)
        around = self.around[self.step % len(self.around)]
        self.step += 1
        return (around + offset).clamp(self.low, self.high)


@dataclass(frozen=True, eq=False)
class PDMovements(Settings):
    r"""Simple movements of a PD controller around a pose (Section 5.2.4).

    .. math:: u = \operatorname{clip}_{\pm u_{\max}}\left(u_{\mathrm{ff}}(x) + K (x^* - x)\right)

    The target :math:`x^*` is drawn uniformly around the pose, and anew every ``hold`` steps.

    Args:
        pose: state (D,) around which the robot moves.
        reach: largest distances (D,) of a target from the pose, in its units; 0 for velocities.
        gain: K (F, D): stiffness (N·m/rad) in the columns of the positions, damping (N·m·s/rad) in
            those of the velocities.
        u_max: torque limits (F,), N·m.
        hold: control steps for which a target stays.
        rollouts, steps: number of rollouts, and control steps of each.
        feedforward: torques (*batch, F) at states (*batch, D), which carry the robot's weight.

    Raises:
        ValueError: shapes do not fit each other, a number is not finite, a distance is negative,
            or a number is not positive.

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
        if self.reach.shape != (D,) or self.gain.shape != (F, D):
            got = f"{tuple(self.reach.shape)} and {tuple(self.gain.shape)}"
            raise ValueError(
                f"exploration.reach and gain must have shapes ({D},) and ({F}, {D}) for a pose of "
                f"{D} and {F} torques, got {got}"
            )
        check_finite_entries("u_max", self.u_max)
        if not (self.u_max > 0).all():
            raise ValueError(f"u_max must be positive, got {self.u_max.tolist()}")

    @property
    def settings(self) -> dict[str, object]:
        """Numbers on which a run depends, in types that JSON has."""
        return {name.removeprefix(self.prefix): value for name, value in self.adjustable.items()}

    def motion(self, generator: torch.Generator) -> Motion:
        """Motion of the PD controller, with targets drawn from a generator."""
        return _PDControl(self, generator)


class _PDControl:
    amplitude = 1.0

    def __init__(self, movements: PDMovements, generator: torch.Generator) -> None:
        self.movements, self.generator = movements, generator
        self.begin()

    def begin(self) -> None:
        """Start a new rollout, whose first target is drawn at the next step."""
        self.step = 0

    def __call__(self, state: Tensor) -> Tensor:
        movements, state = self.movements, state.double()
        if self.step % movements.hold == 0:
            offset = 2 * torch.rand(state.shape, dtype=torch.float64, generator=self.generator) - 1
            self.target = movements.pose + self.amplitude * movements.reach * offset
        self.step += 1
        torque = movements.feedforward(state) + (self.target - state) @ movements.gain.double().mT
        return torque.clamp(-movements.u_max, movements.u_max)
