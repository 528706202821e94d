"""Robots that write: where, in which pose, and what it takes to be there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torch_pmil.control.exploration import PDMovements
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.control.state_space import StateSpace
from torch_pmil.control.trigonometric_polynomial import cosine, match_of, sine
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.biorob import BioRobEnv, holding_torques
from torch_pmil.envs.double_pendulum import (
    LINK_LENGTH,
    DoublePendulumEnv,
    double_pendulum_model,
    pose_at,
)
from torch_pmil.envs.joint_torques import tracking_torques
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.biorob import biorob_space
from torch_pmil.tasks.double_pendulum import double_pendulum_space
from torch_pmil.tasks.method import VELOCITIES, ModelSettings
from torch_pmil.tasks.strokes import placed

BIOROB_SHOULDER = 1.1  # m above the floor
BIOROB_LINKS = (0.37, 0.6)  # m: shoulder to elbow, elbow to the racket's centre, the wrist straight
HOLD, ROLLOUTS = 5, 3  # control steps of a target and rollouts, of the exploration
BOARD = 0.6  # m in front of the BioRob's shoulder


@dataclass(frozen=True, eq=False)
class Writer:
    """A robot whose tip writes in a vertical plane."""

    make_env: Callable[..., MujocoRobotEnv]  # takes ``initial_mean`` and ``initial_std``
    space: StateSpace  # its match space holds the tip's place
    origin: Tensor  # middle of what is written (M,), m
    plane: Tensor  # in which it is written (2, M): to the right, and up
    extent: float  # of what is written, m
    duration: float  # in which a shape is written, s
    pose: Callable[[Tensor], Tensor]  # joints (*batch, J), rad, with the tip at (*batch, M)
    torques: Callable[[Tensor, Tensor, Tensor], Tensor]  # (S, F) of a motion of the joints (S, J)
    stiffness: tuple[float, ...]  # of the PD controller that explores, N·m/rad
    damping: tuple[float, ...]  # N·m·s/rad
    reach: float  # of the exploration, in half ranges of the demonstrated positions
    search: SearchSettings
    model: ModelSettings = field(default_factory=ModelSettings)

    def state(self, positions: Tensor, velocities: Tensor) -> Tensor:
        """States (*batch, D) of joints (*batch, J)."""
        rates = rates_of(self.space.names)
        order = torch.tensor([*rates.values(), *rates]).argsort()
        return torch.cat([positions, velocities], -1)[..., order]

    def on_board(self, pen: Demonstrations) -> Demonstrations:
        """Strokes of a pen, [x, y] in m, moved and scaled into this robot's match space."""
        positions = self.origin + placed(pen, self.extent).positions @ self.plane
        return Demonstrations(positions, pen.time_step, self.space.match_space.names)

    def positions(self, states: Tensor) -> Tensor:
        """Joint positions (*batch, J) of states (*batch, D)."""
        return states[..., list(rates_of(self.space.names).values())]

    def holding_torques(self, states: Tensor) -> Tensor:
        """Torques (*batch, F), N·m, that hold the joints against gravity in states (*batch, D)."""
        positions = self.positions(states.double()).detach()
        flat = positions.reshape(-1, positions.shape[-1])
        still = torch.zeros_like(flat)
        return self.torques(flat, still, still).reshape(positions.shape)

    def movements(self, states: Tensor, u_max: Tensor, steps: int) -> PDMovements:
        """Exploration by movements all over the demonstrated states (S, D), as in Section 5.2.4."""
        positions = self.positions(states)
        lowest, highest = positions.amin(0), positions.amax(0)
        still = torch.zeros_like(lowest)
        stiffness, damping = torch.tensor([self.stiffness, self.damping], dtype=torch.float64)
        return PDMovements(
            self.state((highest + lowest) / 2, still),
            self.state(self.reach * (highest - lowest) / 2, still),
            self.state(stiffness.diag(), damping.diag()),
            u_max,
            hold=HOLD,
            rollouts=ROLLOUTS,
            steps=steps,
            feedforward=self.holding_torques,
        )


def pendulum_writer() -> Writer:
    """The double pendulum's tip, 0.65 m below its base.

    Example:
        >>> pendulum_writer().space.match_space.names
        ('x', 'y')
    """
    first, both = (1, 0), (1, 1)
    tip = [LINK_LENGTH * wave(first) + LINK_LENGTH * wave(both) for wave in (sine, cosine)]
    match_space = match_of(tip, ("x", "y"), ("m", "m"), dim=4, angles=(0, 2))
    return Writer(
        make_env=DoublePendulumEnv,
        space=replace(double_pendulum_space(), match_space=match_space),
        origin=torch.tensor([0.0, -0.65], dtype=torch.float64),
        plane=torch.eye(2, dtype=torch.float64),
        extent=0.3,
        duration=3.0,
        pose=pose_at,
        torques=_pendulum_torques,
        stiffness=(2.0, 0.5),
        damping=(0.6, 0.12),
        reach=1.0,
        search=SearchSettings(
            mean_iterations=30, stage_iterations=20, final_iterations=60, trust_threshold=0.5
        ),
        model=VELOCITIES,
    )


def biorob_writer() -> Writer:
    """The BioRob's racket, on a board in front of it: to the right as the robot sees it, and up.

    The racket's centre is at [x, y, z] (m; forwards, to the left, up from the floor). Its wrist is
    taken to be straight: the springs give way by less than a millimetre.

    Example:
        >>> hanging = torch.zeros(6, dtype=torch.float64)
        >>> biorob_writer().space.observe(hanging).round(decimals=3)
        tensor([0.0000, 0.0000, 0.1300], dtype=torch.float64)
    """
    yaw, shoulder, both, none = (1, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 0)
    upper, lower = BIOROB_LINKS
    outwards = upper * sine(shoulder) + lower * sine(both)
    up = BIOROB_SHOULDER * cosine(none) + -upper * cosine(shoulder) + -lower * cosine(both)
    match_space = match_of(
        [cosine(yaw) * outwards, sine(yaw) * outwards, up],
        ("x", "y", "z"),
        ("m",) * 3,
        dim=6,
        angles=(0, 1, 2),
    )
    return Writer(
        make_env=BioRobEnv,
        space=replace(biorob_space(), match_space=match_space),
        origin=torch.tensor([BOARD, 0.0, 0.9], dtype=torch.float64),
        plane=torch.tensor([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64),
        extent=0.5,
        duration=2.0,
        pose=biorob_pose,
        torques=_biorob_torques,
        stiffness=(8.0, 20.0, 10.0),
        damping=(0.3, 0.5, 0.2),
        reach=1.5,
        search=SearchSettings(mean_iterations=0, stage_iterations=30, final_iterations=60),
    )


def biorob_pose(places: Tensor) -> Tensor:
    """Yaw, shoulder and elbow (*batch, 3), rad, with the racket's centre at places (*batch, 3).

    Places are [x, y, z] in m; the elbow is below.

    Raises:
        ValueError: a place is out of the arm's reach.

    Example:
        >>> pose = biorob_pose(torch.tensor([0.6, 0.0, 0.73], dtype=torch.float64))
        >>> pose.rad2deg().round() + 0.0
        tensor([ 0.,  0., 90.], dtype=torch.float64)
    """
    upper, lower = BIOROB_LINKS
    x, y, z = places.unbind(-1)
    outwards, below = torch.hypot(x, y), BIOROB_SHOULDER - z
    cos_elbow = (outwards**2 + below**2 - upper**2 - lower**2) / (2 * upper * lower)
    bad = places[cos_elbow.abs() > 1]
    if len(bad):
        raise ValueError(
            f"places must be within {lower - upper:.2g} to {lower + upper:.2g} m of the shoulder, "
            f"got {bad[0].tolist()}"
        )
    elbow = cos_elbow.acos()
    bend = torch.atan2(lower * elbow.sin(), upper + lower * elbow.cos())
    shoulder = torch.atan2(outwards, below) - bend
    return torch.stack([torch.atan2(y, x), shoulder, elbow], -1)


def states_of_strokes(writer: Writer, strokes: Demonstrations) -> Tensor:
    """States (N, T + 1, D) with the tip on strokes in the match space, by inverse kinematics.

    Velocities are central differences.

    Raises:
        DemonstrationError: a stroke leaves the robot's reach, or takes more torque than there is;
            the message says where.
    """
    try:
        positions = writer.pose(strokes.positions)
    except ValueError as error:
        raise DemonstrationError(f"strokes must stay in the robot's reach: {error}") from error
    velocities = torch.gradient(positions, spacing=strokes.time_step, dim=1)[0]
    accelerations = torch.gradient(velocities, spacing=strokes.time_step, dim=1)[0]
    motion = (part.flatten(0, 1) for part in (positions, velocities, accelerations))
    limits = writer.make_env().action_spec.space.high
    needed = writer.torques(*motion).reshape(*positions.shape[:2], -1).abs()
    excess = (needed - limits).clamp(min=0).nonzero()
    if len(excess):
        stroke, step, motor = excess[0].tolist()
        raise DemonstrationError(
            f"stroke {stroke} needs {needed[stroke, step, motor]:.3g} N·m of motor {motor} at "
            f"{step * strokes.time_step:.1f} s, which has {limits[motor]:.3g} N·m"
        )
    return writer.state(positions, velocities)


def _pendulum_torques(positions: Tensor, velocities: Tensor, accelerations: Tensor) -> Tensor:
    states = torch.stack([positions, velocities], -1).flatten(-2)
    return tracking_torques(double_pendulum_model(), states, accelerations)


def _biorob_torques(positions: Tensor, velocities: Tensor, accelerations: Tensor) -> Tensor:
    """Torques against gravity alone: what cables and friction take beside them is not known."""
    return holding_torques(positions)
