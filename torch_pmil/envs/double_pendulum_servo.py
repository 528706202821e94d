"""The double pendulum of Sec. 5.1 with a position servo in each joint."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
from torch import Tensor

from torch_pmil.envs.double_pendulum import (
    HANGING,
    PICTURE,
    START_STD,
    double_pendulum_spec,
)
from torch_pmil.envs.mujoco import MujocoRobotEnv

SETPOINT_RANGE = (4.0, 3.0)  # rad, of q1 and q2
SERVOS = {"tau1": "setpoint1", "tau2": "setpoint2"}  # in place of the motors


class DoublePendulumServoEnv(MujocoRobotEnv):
    r"""The double pendulum whose actions are angles for its servos, in MuJoCo, at 10 Hz.

    State, links and starts are those of :class:`DoublePendulumEnv`; the action is the setpoint u of
    each joint's servo in rad, held for a control period. A servo's torque is
    :math:`k_p (u - q) - k_v \dot q`, within its limit.

    Args:
        link_masses: masses of the two rods in kg.
        stiffness: :math:`k_p` of both servos, N·m/rad.
        damping: :math:`k_v` of both servos, N·m·s/rad.
        torque_limit: largest absolute torque of a servo, N·m.
        initial_mean: mean of the start state, length 4.
        initial_std: standard deviations of the start state, length 4.
        observation_std: standard deviations of the sensors' noise, length 4; None for exact
            sensors.
        control_period: seconds between two actions; a whole number of 2 ms steps.
        num_envs: None for one robot with batch size (), N for N robots with batch size (N,).
        from_pixels: whether to draw a picture (480, 480, 3) at each step under ``"pixels"``.
        seed: of the generator of starts and noise; None takes entropy from the system.

    Raises:
        ValueError: a setting has the wrong shape or range; the message says what was expected and
            what came.

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
        initial_mean: Sequence[float] | Tensor = HANGING,
        initial_std: Sequence[float] | Tensor = START_STD,
        observation_std: Sequence[float] | Tensor | None = None,
        control_period: float = 0.1,
        num_envs: int | None = None,
        from_pixels: bool = False,
        seed: int | None = None,
    ) -> None:
        super().__init__(
            double_pendulum_servo_model(link_masses, stiffness, damping, torque_limit),
            joints=("q1", "q2"),
            initial_mean=initial_mean,
            initial_std=initial_std,
            observation_std=observation_std,
            control_period=control_period,
            num_envs=num_envs,
            from_pixels=from_pixels,
            pixel_size=PICTURE,
            seed=seed,
        )


def double_pendulum_servo_model(
    link_masses: Sequence[float] = (0.5, 0.5),
    stiffness: float = 10.0,
    damping: float = 1.0,
    torque_limit: float = 3.5,
) -> mujoco.MjModel:
    """The MuJoCo model of the double pendulum with position servos in place of its motors.

    Args:
        link_masses: masses of the two rods in kg.
        stiffness, damping, torque_limit: of both servos, in N·m/rad, N·m·s/rad and N·m.

    Returns:
        The compiled model, Runge-Kutta at 2 ms.

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
