"""The double pendulum of Sec. 5.1: two uniform rods with a motor in each joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Unpack

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torch_pmil.envs.mujoco import MujocoRobotEnv, RobotSettings
from torch_pmil.envs.mujoco_model import asset

LINK_LENGTH = 0.5  # m, paper
HANGING = (math.pi, 0.0, 0.0, 0.0)  # rad and rad/s, the mean of the start
START_STD = (0.05, 0.1, 0.05, 0.1)  # rad and rad/s
PICTURE = (480, 480)  # pixels
HANGS_AT_REST = RobotSettings(initial_mean=HANGING, initial_std=START_STD, pixel_size=PICTURE)


class DoublePendulumEnv(MujocoRobotEnv):
    """Two actuated links on a fixed base, in MuJoCo, at 10 Hz (Sec. 5.1).

    The state is x = [q1, dq1, q2, dq2] (rad, rad/s): q1 is the angle of link 1 from upright (0 up,
    pi hanging), q2 the angle of link 2 relative to link 1. The link ends are at x1 = l sin q1, y1 =
    l cos q1, x2 = x1 + l sin(q1 + q2) and y2 = y1 + l cos(q1 + q2), with l = 0.5 m. The action is
    the torque of the two joints in N·m.

    Stated in the paper: masses, lengths, torque limit, control rate. Chosen here: links are uniform
    rods (inertia m l²/12 about the centre), the start hangs with standard deviations of 0.05 rad
    and 0.1 rad/s; no friction.

    Args:
        link_masses: masses of the two rods in kg.
        torque_limit: largest absolute torque in N·m, one for both motors or one each.
        settings: such as ``num_envs`` and ``seed``: see :class:`MujocoRobotEnv`.

    Raises:
        ValueError: a setting has the wrong shape or range.

    Example:
        >>> env = DoublePendulumEnv(seed=0)
        >>> env.rollout(25)["next", "observation"].shape
        torch.Size([25, 4])
        >>> from tensordict import TensorDict
        >>> upright = torch.zeros(4, dtype=torch.float64)
        >>> env.reset(TensorDict({"observation": upright}))["observation"]
        tensor([0., 0., 0., 0.], dtype=torch.float64)
    """

    def __init__(
        self,
        link_masses: Sequence[float] = (0.5, 0.5),
        *,
        torque_limit: float | Sequence[float] = 3.5,
        **settings: Unpack[RobotSettings],
    ) -> None:
        model = double_pendulum_model(link_masses)
        super().__init__(
            model, ("q1", "q2"), torque_limit=torque_limit, **(HANGS_AT_REST | settings)
        )


def link_positions(state: Tensor) -> Tensor:
    """Positions [x1, y1, x2, y2] of the two link ends in states (*batch, 4): (*batch, 4), m.

    x points to the right, y up; the base is at the origin.

    Example:
        >>> link_positions(torch.zeros(4))
        tensor([0.0000, 0.5000, 0.0000, 1.0000])
    """
    inner, outer = state[..., 0], state[..., 0] + state[..., 2]  # angles from upright
    x1, y1 = LINK_LENGTH * inner.sin(), LINK_LENGTH * inner.cos()
    return torch.stack(
        [x1, y1, x1 + LINK_LENGTH * outer.sin(), y1 + LINK_LENGTH * outer.cos()], dim=-1
    )


def double_pendulum_model(
    link_masses: Sequence[float] = (0.5, 0.5),
    link_lengths: Sequence[float] = (LINK_LENGTH, LINK_LENGTH),
) -> mujoco.MjModel:
    """The MuJoCo model of the double pendulum, Runge-Kutta at 2 ms.

    Args:
        link_masses: masses of the two rods in kg; their inertia about the centre is m l²/12.
        link_lengths: their lengths in m.

    Raises:
        ValueError: masses or lengths are not two positive finite numbers.

    Example:
        >>> double_pendulum_model((0.5, 0.15)).body("link2").mass
        array([0.15])
        >>> double_pendulum_model(link_lengths=(0.4, 0.6)).body("link2").pos
        array([0. , 0. , 0.4])
    """
    return double_pendulum_spec(link_masses, link_lengths).compile()


def double_pendulum_spec(
    link_masses: Sequence[float], link_lengths: Sequence[float] = (LINK_LENGTH, LINK_LENGTH)
) -> mujoco.MjSpec:
    """Specification of :func:`double_pendulum_model`."""
    masses = _two_positive("link_masses", link_masses, "kg")
    lengths = _two_positive("link_lengths", link_lengths, "m")
    spec = asset("double_pendulum.xml")
    for number, (mass, length) in enumerate(zip(masses, lengths, strict=True), start=1):
        inertia, link = mass * length**2 / 12, spec.body(f"link{number}")
        link.mass = mass
        # the third, about the rod's own axis, has no effect
        link.inertia = [inertia, inertia, inertia / 100]
        link.ipos = [0, 0, length / 2]
        spec.geom(f"rod{number}").fromto[5] = length
    spec.body("link2").pos = spec.site("elbow").pos = [0, 0, lengths[0]]
    spec.site("tip").pos = [0, 0, lengths[1]]
    return spec


def _two_positive(name: str, numbers: Sequence[float], unit: str) -> NDArray[np.float64]:
    values = np.asarray(numbers, dtype=np.float64)
    if values.shape != (2,) or not (np.isfinite(values) & (values > 0)).all():
        raise ValueError(f"{name} must be two positive finite numbers in {unit}, got {numbers}")
    return values


def pose_at(targets: Tensor) -> Tensor:
    """Angles [q1, q2], (*batch, 2), rad, with the tip at targets [x, y], (*batch, 2), m.

    The elbow is to the left of the target as seen from the base. So q2 is from -pi to 0, and q1
    from 0 to 2 pi about hanging (pi).

    Raises:
        ValueError: a target is the base itself or out of reach.

    Example:
        >>> target = torch.tensor([0.5, -0.5], dtype=torch.float64)
        >>> pose_at(target)  # link 1 hangs, link 2 points to the right
        tensor([ 3.1416, -1.5708], dtype=torch.float64)
    """
    reach = targets.norm(dim=-1)
    bad = targets[~((reach > 0) & (reach <= 2 * LINK_LENGTH))]
    if len(bad):
        raise ValueError(
            f"targets must be in the arm's reach, from 0 to {2 * LINK_LENGTH} m from its base, got "
            f"{bad[0].tolist()}"
        )
    direction = torch.atan2(targets[..., 0], targets[..., 1]).remainder(2 * math.pi)
    bend = (reach / (2 * LINK_LENGTH)).acos()
    return torch.stack([direction + bend, -2 * bend], dim=-1)
