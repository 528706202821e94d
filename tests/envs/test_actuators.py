"""Robots take what the actuators of their MuJoCo models are."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from torch_pmil.envs import DoublePendulumEnv, DoublePendulumServoEnv, MujocoRobotEnv
from torch_pmil.envs.actuators import actuator_kinds, actuator_units
from torch_pmil.envs.double_pendulum_servo import double_pendulum_servo_model

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint name="lift" type="slide" axis="0 0 1" damping="1"/>
      <geom type="box" size="0.1 0.1 0.1" mass="2"/>
      <body pos="0 0 0.1">
        <joint name="turn" axis="0 1 0" range="-1 2" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator>{}</actuator>
</mujoco>
"""
SERVOS = """
<position name="elbow" joint="turn" kp="40" kv="4" inheritrange="1" forcerange="-5 6"/>
<position name="height" joint="lift" kp="900" kv="60" ctrlrange="-0.1 0.3"/>
"""


def arm(actuators: str, **settings: object) -> MujocoRobotEnv:
    model = mujoco.MjModel.from_xml_string(ARM.format(actuators))
    start = {"initial_mean": [0.0, 0.0, 0.5, 0.0], "initial_std": [0.0] * 4}
    return MujocoRobotEnv(model, ["lift", "turn"], **start, **settings)


def test_servos_have_their_own_ranges_and_units() -> None:
    env = arm(SERVOS)
    assert env.action_names == ("elbow", "height") and env.action_units == ("rad", "m")
    torch.testing.assert_close(env.action_spec.space.low, torch.tensor([-1.0, -0.1]).double())
    torch.testing.assert_close(env.action_spec.space.high, torch.tensor([2.0, 0.3]).double())
    assert env.torque_limits.tolist() == [6.0, float("inf")]


def test_servos_and_motors_that_are_to_hold_the_robot_do() -> None:
    """Whatever the order of the actuators is, which of the arm is not that of the joints."""
    env = arm(SERVOS)
    held = env.holding_actions(env.initial_mean[None])[0]
    gravity = 9.81 * 0.15 * np.cos(0.5)  # of the rod, whose rotation is towards the floor
    torch.testing.assert_close(held[0].item(), 0.5 - gravity / 40, rtol=0.02, atol=0)
    torch.testing.assert_close(held[1].item(), 3 * 9.81 / 900, rtol=1e-6, atol=0)
    motors = DoublePendulumEnv(initial_mean=[0.3, 0.0, -0.2, 0.0], initial_std=[0.0] * 4)
    for each, steps, tolerance in ((env, 20, 1e-6), (motors, 1, 1e-9)):
        held = each.holding_actions(each.initial_mean[None])[0]
        after = each.rollout(steps, lambda state, held=held: held)["next", "observation"]
        expected = each.initial_mean.expand(steps, 4)
        torch.testing.assert_close(after, expected, rtol=0, atol=tolerance)


def test_torques_that_a_motion_needs_are_in_the_order_of_the_actuators() -> None:
    """Those at rest are the forces on the joints that hold it."""
    env = arm(SERVOS)
    needed = env.needed_torques(env.initial_mean.expand(6, -1))
    torch.testing.assert_close(needed[:, 1], torch.full((5,), 3 * 9.81).double())
    assert (needed[:, 0].abs() < 2).all()


def test_kinds_and_units_are_told_from_the_model() -> None:
    model = mujoco.MjModel.from_xml_string(
        ARM.format(
            '<motor joint="turn"/><motor joint="lift"/><position joint="turn" kp="3"/>'
            '<velocity joint="turn" kv="2"/><velocity joint="lift" kv="2"/>'
            '<general joint="turn" gainprm="2" biastype="affine" biasprm="1 -2 0"/>'
        )
    )
    kinds = ("motor", "motor", "position", "velocity", "velocity", "other")
    assert actuator_kinds(model) == kinds
    assert actuator_units(model) == ("N·m", "N", "rad", "rad/s", "m/s", "")


def test_torque_limit_is_that_of_the_motors_alone() -> None:
    mixed = '<motor joint="lift"/><position joint="turn" ctrlrange="-1 1"/>'
    env = arm(mixed, torque_limit=7.0)
    assert env.action_spec.space.high.tolist() == [7.0, 1.0]
    with pytest.raises(ValueError, match="torque_limit must be one or 1 positive finite numbers"):
        arm(mixed, torque_limit=(7.0, 1.0))


def test_actuator_without_a_range_is_named() -> None:
    line = (
        "actuator elbow must have a ctrlrange, or inheritrange, that bounds its actions, got none"
    )
    with pytest.raises(ValueError, match=line):
        arm('<position name="elbow" joint="turn" kp="3"/><motor joint="lift" ctrlrange="-1 1"/>')


def test_robot_with_a_joint_that_nothing_moves_cannot_be_told_to_hold() -> None:
    env = arm('<motor name="lifter" joint="lift" ctrlrange="-1 1"/>')
    assert env.needed_torques(env.initial_mean.expand(6, -1)) is None
    with pytest.raises(ValueError, match=r"got the joints lift, turn and the actuators lifter"):
        env.holding_actions(env.initial_mean[None])


def test_torque_of_a_servo_is_stiffness_damping_and_limit() -> None:
    model = double_pendulum_servo_model(stiffness=12.0, damping=0.7, torque_limit=2.0)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (2.5, 0.4), (0.3, -1.0), (2.4, 0.9)
    mujoco.mj_forward(model, data)
    free = -12.0 * 0.1 - 0.7 * 0.3, 12.0 * 0.5 + 0.7
    np.testing.assert_allclose(data.actuator_force, [free[0], 2.0], rtol=1e-12)
    assert free[1] > 2


@pytest.mark.parametrize("name", ["stiffness", "damping", "torque_limit"])
def test_gains_that_are_none_are_named(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be positive and finite, got -1.0"):
        DoublePendulumServoEnv(**{name: -1.0})
