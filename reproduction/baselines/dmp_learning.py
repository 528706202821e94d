"""Imitation with movement primitives, a learned inverse model and a PD controller (Sec. 5.1)."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from reproduction.baselines.dmp import DMP
from reproduction.baselines.learned_inverse_dynamics import (
    InverseDynamics,
    Reference,
    TrackingController,
    accelerations_from_velocities,
)
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.rollouts import states_of
from torch_pmil.model.forward_model import FitResult

# torques (*batch, F) at a step of the feedback in states (*batch, D)
Controller = Callable[[int, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a robot, at its control steps.

    Args:
        states: x_0..x_T, (*batch, T + 1, D).
        torques: means over the control steps, (*batch, T, F), N·m.
    """

    states: Tensor
    torques: Tensor


def dmp_reference(dmp: DMP, steps: int, time_step: float, hold: int) -> Reference:
    """The primitive's motion at ``steps`` control steps of ``time_step`` seconds, and at ``hold``
    steps of the feedback in each.

    Example:
        >>> rest = torch.zeros(1, dtype=torch.float64)
        >>> dmp = DMP(rest, rest, rest, torch.zeros(2, 1).double(), duration=1.0)
        >>> dmp_reference(dmp, steps=10, time_step=0.1, hold=5).states.shape
        torch.Size([51, 2])
    """
    y, dy, ddy = dmp(torch.arange(steps * hold + 1, dtype=torch.float64) * (time_step / hold))
    return Reference(torch.stack([y, dy], -1).flatten(1), ddy[::hold])


def random_torques(
    u_max: Tensor, fraction: float, hold: int, generator: torch.Generator
) -> Controller:
    """A controller of uniform random torques (F,) for one robot, up to a fraction of the limits.

    They are drawn anew at each control step.
    """
    torques = torch.zeros_like(u_max)

    def controller(step: int, state: Tensor) -> Tensor:
        nonlocal torques
        if step % hold == 0:
            uniform = torch.rand(u_max.shape, dtype=torch.float64, generator=generator)
            torques = fraction * u_max * (2 * uniform - 1)
        return torques

    return controller


def execute(env: MujocoRobotEnv, controller: Controller, steps: int, hold: int) -> Motion:
    """Run a controller from a fresh start.

    The environment's period is that of the feedback; ``hold`` of them make a control step.
    """
    time = itertools.count()

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", controller(next(time), tensordict["observation"]))

    rollout = env.rollout(steps * hold, act)
    torques = rollout["action"].unflatten(-2, (steps, hold)).mean(-2)
    return Motion(states_of(rollout)[..., ::hold, :], torques)


class InverseDynamicsLearner:
    """Learns the inverse model from all motion of the robot so far, and tracks a reference with it.

    Args:
        space: of the robot's states.
        reference: what to track.
        u_max: torque limits (F,), N·m.
        time_step: between control steps, s.
    """

    def __init__(
        self,
        space: StateSpace,
        reference: Reference,
        u_max: Tensor,
        time_step: float,
    ) -> None:
        self.inverse = InverseDynamics(space)
        self.controller = TrackingController(self.inverse, reference, u_max)
        self.reference = reference
        self.time_step = time_step
        self.experience: list[Motion] = []

    @property
    def experience_s(self) -> float:
        """Seconds of the robot's motion so far."""
        return self.time_step * sum(len(motion.torques) for motion in self.experience)

    def add(self, motion: Motion) -> None:
        """Add one rollout, of states (T + 1, D), to the experience."""
        self.experience.append(motion)

    def fit(self) -> FitResult:
        """Learn the inverse model anew from all experience."""
        data = [self._transitions(motion) for motion in self.experience]
        return self.inverse.fit(*(torch.cat(entries) for entries in zip(*data, strict=True)))

    def execute(self, env: MujocoRobotEnv) -> Motion:
        """Track the reference from a fresh start of each of the environment's robots."""
        hold = self.reference.hold
        return execute(env, self.controller, (len(self.reference.states) - 1) // hold, hold)

    def tracking_error(self, motion: Motion) -> float:
        """Root mean square distance of the joint angles from the reference, rad."""
        error = motion.states - self.reference.states[:: self.reference.hold]
        return error[..., 0::2].square().mean().sqrt().item()

    def _transitions(self, motion: Motion) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """States, next ones, next accelerations and torques, (n, ...) each."""
        accelerations = accelerations_from_velocities(motion.states[:, 1::2], self.time_step)
        return motion.states[:-1], motion.states[1:], accelerations[1:], motion.torques
