"""The pole on a cart of PILCO, hanging at first: one motor pushes the cart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import resources

import mujoco
from torch import Tensor

from torch_pmil.envs.double_pendulum import PICTURE
from torch_pmil.envs.mujoco import MujocoRobotEnv

POLE_LENGTH = 0.6  # m, published
HANGING = (0.0, 0.0, math.pi, 0.0)  # m, m/s, rad and rad/s, the mean of the start
START_STD = (0.1, 0.1, 0.1, 0.1)  # m, m/s, rad and rad/s, published
CONTROL_PERIOD = 0.1  # s, published


class CartPoleEnv(MujocoRobotEnv):
    """A pole on a cart on an endless rail, in MuJoCo, at 10 Hz.

    The state is x = [x, dx, q, dq] (m, m/s, rad, rad/s): x is the place of the cart, q the angle of
    the pole from upright (0 up, pi hanging). The tip of the pole is at x + l sin q to the right and
    l cos q up, with l = 0.6 m. The action is the force on the cart in N; no motor turns the pole.

    Published with PILCO (Deisenroth and Rasmussen, 2011): cart and pole of 0.5 kg each, the pole a
    uniform rod of 0.6 m (0.5 m in their code, whose equations, gravity of 9.82 m/s² and start are
    these), friction of the cart of 0.1 N·s/m, up to 10 N, held for 0.1 s, and that the start hangs
    with standard deviations of 0.1 in all four entries. Chosen here: integration by Runge-Kutta at
    2 ms, and exact sensors.

    Args:
        torque_limit: largest absolute force of the motor in N.
        initial_mean: mean of the start state, length 4.
        initial_std: standard deviations of the start state, length 4.
        control_period: seconds between two actions; a whole number of 2 ms steps.
        num_envs: None for one robot with batch size (), N for N robots with batch size (N,).
        from_pixels: whether to draw a picture (480, 480, 3) at each step under ``"pixels"``.
        seed: of the generator of starts; None takes entropy from the system.

    Raises:
        ValueError: a setting has the wrong shape or range; the message says what was expected and
            what came.

    Example:
        >>> env = CartPoleEnv(seed=0)
        >>> env.action_names, env.action_units, env.rollout(10)["next", "observation"].shape
        (('force',), ('N',), torch.Size([10, 4]))
    """

    def __init__(
        self,
        *,
        torque_limit: float = 10.0,
        initial_mean: Sequence[float] | Tensor = HANGING,
        initial_std: Sequence[float] | Tensor = START_STD,
        control_period: float = CONTROL_PERIOD,
        num_envs: int | None = None,
        from_pixels: bool = False,
        seed: int | None = None,
    ) -> None:
        super().__init__(
            cart_pole_model(),
            joints=("x", "q"),
            initial_mean=initial_mean,
            initial_std=initial_std,
            torque_limit=torque_limit,
            control_period=control_period,
            num_envs=num_envs,
            from_pixels=from_pixels,
            pixel_size=PICTURE,
            seed=seed,
        )


def cart_pole_model() -> mujoco.MjModel:
    """The MuJoCo model of cart and pole, Runge-Kutta at 2 ms.

    Example:
        >>> cart_pole_model().body("pole").mass
        array([0.5])
    """
    asset = resources.files("torch_pmil.envs").joinpath("assets", "cart_pole.xml")
    return mujoco.MjSpec.from_string(asset.read_text(encoding="utf-8")).compile()
