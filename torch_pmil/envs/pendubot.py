"""The double pendulum of the AI Olympics with RealAIGym, with one motor: pendubot and acrobot."""

from __future__ import annotations

from typing import ClassVar, Unpack

import mujoco
from torch import Tensor

from torch_pmil.envs.double_pendulum import HANGS_AT_REST
from torch_pmil.envs.mujoco import MujocoRobotEnv, RobotSettings
from torch_pmil.envs.mujoco_model import asset

LINK_LENGTHS = (0.2, 0.3)  # m, published
MOTORS = ("tau1", "tau2")
CONTROL_PERIOD = 0.04  # s


class PendubotEnv(MujocoRobotEnv):
    """Two links on a fixed base with a motor in the shoulder alone, in MuJoCo, at 25 Hz.

    The state is x = [q1, dq1, q2, dq2] (rad, rad/s): q1 is the angle of link 1 from upright (0 up,
    pi hanging), q2 the angle of link 2 relative to link 1. The action is the torque of the motor in
    N·m.

    Published: lengths, masses, centres of mass and inertias of the links, no friction, torque
    limit, integration by Runge-Kutta at 2 ms (AI Olympics with RealAIGym, design C.1, model 1.0).
    Chosen here: the control rate, and that the start hangs with standard deviations of 0.05 rad
    and 0.1 rad/s.

    Args:
        torque_limit: largest absolute torque in N·m.
        settings: such as ``num_envs`` and ``seed``: see :class:`MujocoRobotEnv`.

    Raises:
        ValueError: a setting has the wrong shape or range.

    Example:
        >>> env = PendubotEnv(seed=0)
        >>> env.action_names, env.rollout(10)["next", "observation"].shape
        (('tau1',), torch.Size([10, 4]))
    """

    motor: ClassVar[str] = "tau1"

    def __init__(self, *, torque_limit: float = 6.0, **settings: Unpack[RobotSettings]) -> None:
        defaults = RobotSettings(control_period=CONTROL_PERIOD, **HANGS_AT_REST)
        super().__init__(
            one_motor_model(self.motor),
            ("q1", "q2"),
            torque_limit=torque_limit,
            **(defaults | settings),
        )


class AcrobotEnv(PendubotEnv):
    """The links of :class:`PendubotEnv` with a motor in the elbow alone.

    Example:
        >>> AcrobotEnv(seed=0).action_names
        ('tau2',)
    """

    motor: ClassVar[str] = "tau2"


def tip_height(states: Tensor) -> Tensor:
    """Height (*batch) of the end of link 2 above the base, m, in states (*batch, 4).

    Example:
        >>> import torch
        >>> tip_height(torch.zeros(4))
        tensor(0.5000)
    """
    inner, outer = states[..., 0], states[..., 0] + states[..., 2]
    return LINK_LENGTHS[0] * inner.cos() + LINK_LENGTHS[1] * outer.cos()


def one_motor_model(motor: str) -> mujoco.MjModel:
    """The MuJoCo model with one motor, ``"tau1"`` in the shoulder or ``"tau2"`` in the elbow.

    Example:
        >>> one_motor_model("tau2").nu
        1
    """
    spec = asset("pendubot.xml")
    for other in set(MOTORS) - {motor}:
        spec.delete(spec.actuator(other))
    return spec.compile()
