"""The double pendulum of Sec. 5.1 with a position servo in each joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Unpack

import mujoco

from torch_pmil.envs.double_pendulum import HANGS_AT_REST, double_pendulum_spec
from torch_pmil.envs.mujoco import MujocoRobotEnv, RobotSettings

SETPOINT_RANGE = (4.0, 3.0)  # rad, of q1 and q2
SERVOS = {"tau1": "setpoint1", "tau2": "setpoint2"}  # in place of the motors


class DoublePendulumServoEnv(MujocoRobotEnv):
    r"""The double pendulum with angles of its servos as actions, in MuJoCo, at 10 Hz.

    State, links and starts are those of :class:`DoublePendulumEnv`. The action is the setpoint u of
    each joint's servo in rad. A servo's torque is :math:`k_p (u - q) - k_v \dot q`, within its
    limit.

    Args:
        link_masses: masses of the two rods in kg.
        stiffness: :math:`k_p` of both servos, N·m/rad.
        damping: :math:`k_v` of both servos, N·m·s/rad.
        torque_limit: largest absolute torque of a servo, N·m.
        settings: such as ``num_envs`` and ``seed``: see :class:`MujocoRobotEnv`.

    Raises:
        ValueError: a setting has the wrong shape or range.

    Example:
        >>> env = DoublePendulumServoEnv(initial_std=(0.0, 0.0, 0.0, 0.0))
        >>> env.action_units, env.action_spec.space.high.tolist()
        (('rad', 'rad'), [4.0, 3.0])
        >>> held = env.holding_actions(env.initial_mean[None])[0]
        >>> rollout = env.rollout(25, lambda state: held)
        >>> (rollout["next", "observation"] - env.initial_mean).abs().max().item() < 1e-9
        True
    """

    def __init__(
        self,
        link_masses: Sequence[float] = (0.5, 0.5),
        *,
        stiffness: float = 10.0,
        damping: float = 1.0,
        torque_limit: float = 3.5,
        **settings: Unpack[RobotSettings],
    ) -> None:
        model = double_pendulum_servo_model(link_masses, stiffness, damping, torque_limit)
        super().__init__(model, ("q1", "q2"), **(HANGS_AT_REST | settings))


def double_pendulum_servo_model(
    link_masses: Sequence[float] = (0.5, 0.5),
    stiffness: float = 10.0,
    damping: float = 1.0,
    torque_limit: float = 3.5,
) -> mujoco.MjModel:
    """The MuJoCo model of the double pendulum with position servos in place of its motors.

    Arguments are those of :class:`DoublePendulumServoEnv`.

    Raises:
        ValueError: a number is not positive and finite.

    Example:
        >>> double_pendulum_servo_model(torque_limit=2.0).actuator("setpoint1").forcerange
        array([-2.,  2.])
    """
    gains = {"stiffness": stiffness, "damping": damping, "torque_limit": torque_limit}
    for name, value in gains.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be positive and finite, got {value}")
    spec = double_pendulum_spec(link_masses)
    for (motor, name), reach in zip(SERVOS.items(), SETPOINT_RANGE, strict=True):
        servo = spec.actuator(motor)
        servo.name, servo.ctrlrange = name, [-reach, reach]
        servo.set_to_position(kp=stiffness, kv=damping)
        servo.forcelimited, servo.forcerange = True, [-torque_limit, torque_limit]
    return spec.compile()
