"""A hand that leads an arm which carries itself: near what it means, no stronger than it is."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from reproduction.teachers.hand import Hand, lead_by_hand, rotation_between

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="a" axis="0 1 0" armature="0.1" damping="0.5"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.03" mass="1" contype="0"/>
      <body pos="0 0 0.4">
        <joint name="b" axis="0 1 0" armature="0.1" damping="0.5"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.03" mass="1" contype="0"/>
        <site name="grip" pos="0 0 0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="a" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
JOINTS = ("a", "b")


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM)


def path(time: float) -> np.ndarray:
    """From (0.5, 0.8) to (0.9, 0.2) rad in a second, at rest at both ends."""
    share = np.clip(time, 0, 1)
    smooth = share**2 * (3 - 2 * share)
    return np.array([0.5, 0.8]) + smooth * np.array([0.4, -0.6])


def test_joints_move_as_the_hand_means(model: mujoco.MjModel) -> None:
    states = lead_by_hand(model, JOINTS, "grip", path, 1.5, Hand(), settling=0.2)
    assert states.shape == (751, 4)
    meant = np.array([path(0.002 * step) for step in range(751)])
    assert np.abs(states[:, :2] - meant).max() < 0.05
    assert np.gradient(states[:, 0], 0.002)[5:-5] == pytest.approx(states[5:-5, 2], abs=0.02)
    assert (model.opt.gravity == [0, 0, -9.81]).all()


def test_pull_is_that_of_spring_and_damper_up_to_its_strength(model: mujoco.MjModel) -> None:
    """At a straight arm along z a force along x turns the joints by its arm of 0.8 m and 0.4 m."""
    data, hand = mujoco.MjData(model), Hand(stiffness=100.0, damping=10.0, force=20.0)
    mujoco.mj_step1(model, data)
    for shift, speed, force in ((0.1, 0.2, 12.0), (0.1, 3.0, 20.0)):
        hand.pull(model, data, "grip", np.array([shift, 0, 0.8]), np.array([speed, 0, 0]))
        assert data.qfrc_applied == pytest.approx([0.8 * force, 0.4 * force])


def test_twist_is_that_of_spring_and_damper_up_to_its_strength(model: mujoco.MjModel) -> None:
    data, still = mujoco.MjData(model), np.zeros(3)
    hand = Hand(turning_stiffness=10.0, turning_damping=2.0, torque=4.0)
    mujoco.mj_step1(model, data)
    turned = np.array([[np.cos(0.2), 0, np.sin(0.2)], [0, 1, 0], [-np.sin(0.2), 0, np.cos(0.2)]])
    place = np.array([0, 0, 0.8])
    for speed, torque in ((0.5, 3.0), (5.0, 4.0)):
        hand.pull(model, data, "grip", place, still, turned, np.array([0, speed, 0]))
        assert data.qfrc_applied == pytest.approx([torque, torque])


def test_rotation_between_matrices_is_the_shorter_way_round() -> None:
    def about_z(angle: float) -> np.ndarray:
        cos, sin = np.cos(angle), np.sin(angle)
        return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])

    assert rotation_between(about_z(0.3), about_z(1.0)) == pytest.approx([0, 0, 0.7])
    assert rotation_between(about_z(3.0), about_z(-3.0)) == pytest.approx([0, 0, 2 * np.pi - 6])


def test_lost_robot_is_an_error(model: mujoco.MjModel) -> None:
    with pytest.raises(
        RuntimeError, match=r"must keep grip within 0\.1 m, it ended 0\.\d\d m away"
    ):
        lead_by_hand(model, JOINTS, "grip", lambda time: 3 * path(time), 1.0, Hand(force=0.1))
