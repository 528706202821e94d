"""The pole on a cart of PILCO, hanging at first: one motor pushes the cart."""

from __future__ import annotations

import math
from typing import Unpack

import mujoco

from torch_pmil.envs.double_pendulum import PICTURE
from torch_pmil.envs.mujoco import MujocoRobotEnv, RobotSettings
from torch_pmil.envs.mujoco_model import asset

POLE_LENGTH = 0.6  # m, published
HANGING = (0.0, 0.0, math.pi, 0.0)  # m, m/s, rad and rad/s, the mean of the start
START_STD = (0.1, 0.1, 0.1, 0.1)  # m, m/s, rad and rad/s, published
CONTROL_PERIOD = 0.1  # s, published


class CartPoleEnv(MujocoRobotEnv):
    """A pole on a cart on an endless rail, in MuJoCo, at 10 Hz.

    The state is x = [x, dx, q, dq] (m, m/s, rad, rad/s): x is the place of the cart, q the angle of
    the pole from upright (0 up, pi hanging). The tip of the pole is at x + l sin q to the right and
    l cos q up, with l = 0.6 m. The action is the force on the cart in N; no motor turns the pole.

    Published with PILCO (Deisenroth and Rasmussen, 2011): a cart and a pole of 0.5 kg each, and
    cart friction of 0.1 N·s/m. The pole is a uniform rod of 0.6 m. The force is up to 10 N, held
    for 0.1 s. The start hangs, with standard deviations of 0.1 in all four entries. Equations,
    start and gravity (9.82 m/s²) are those of their code, where the pole is 0.5 m long. Chosen
    here: integration by Runge-Kutta at 2 ms, and exact sensors.

    Args:
        torque_limit: largest absolute force of the motor in N.
        settings: such as ``num_envs`` and ``seed``: see :class:`MujocoRobotEnv`.

    Raises:
        ValueError: a setting has the wrong shape or range.

    Example:
        >>> env = CartPoleEnv(seed=0)
        >>> env.action_names, env.action_units, env.rollout(10)["next", "observation"].shape
        (('force',), ('N',), torch.Size([10, 4]))
    """

    def __init__(self, *, torque_limit: float = 10.0, **settings: Unpack[RobotSettings]) -> None:
        defaults = RobotSettings(
            initial_mean=HANGING,
            initial_std=START_STD,
            control_period=CONTROL_PERIOD,
            pixel_size=PICTURE,
        )
        super().__init__(
            cart_pole_model(), ("x", "q"), torque_limit=torque_limit, **(defaults | settings)
        )


def cart_pole_model() -> mujoco.MjModel:
    """The MuJoCo model of cart and pole, Runge-Kutta at 2 ms.

    Example:
        >>> cart_pole_model().body("pole").mass
        array([0.5])
    """
    return asset("cart_pole.xml").compile()
