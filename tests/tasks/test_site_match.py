"""The match space of a site is where MuJoCo puts the site, whatever the joints are."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.tasks.site_match import site_match

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <worldbody>
    <body pos="0.1 0 0.3" quat="0.9 0.1 -0.2 0.3">
      <joint name="a" axis="0 0 1" ref="0.2"/>
      <geom size="0.05"/>
      <body pos="0 0.1 0.4" quat="0.7 0 0.7 0">
        <joint name="b" axis="0 1 0.5" pos="0.02 0 0.01"/>
        <joint name="c" axis="1 0 0"/>
        <geom size="0.05"/>
        <body pos="0.3 0 0">
          <joint name="s" type="slide" axis="1 0 0"/>
          <geom size="0.05"/>
          <site name="near" pos="0.1 0 0.05"/>
          <body pos="0.2 0.1 0">
            <joint name="d" axis="0 0 1"/>
            <geom size="0.05"/>
            <site name="tip" pos="0.1 0.2 0.3" quat="0.5 0.5 -0.5 0.5"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="a" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def robot(*joints: str) -> MujocoRobot:
    return MujocoRobot(mujoco.MjSpec.from_string(ARM), joints)


def axes_and_place(of: MujocoRobot, angles: np.ndarray, site: str) -> np.ndarray:
    data = mujoco.MjData(of.model)
    for name, angle in zip(of.joints, angles, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_kinematics(of.model, data)
    matrix = data.site(site).xmat.reshape(3, 3)
    return np.concatenate([data.site(site).xpos, matrix[:, 0], matrix[:, 1]])


@pytest.mark.parametrize("joints", [("a", "b", "c", "d"), ("d", "b"), ("c",)])
@pytest.mark.parametrize("site", ["near", "tip"])
def test_place_and_axes_are_those_of_the_simulation(joints: tuple[str, ...], site: str) -> None:
    of, generator = robot(*joints), np.random.default_rng(0)
    match, place = site_match(of, site, orientation=True), site_match(of, site)
    assert match.names == ("x", "y", "z", "x_x", "x_y", "x_z", "y_x", "y_y", "y_z")
    assert (place.names, place.units) == (("x", "y", "z"), ("m", "m", "m"))
    for angles in generator.normal(0, 2, (5, len(joints))):
        state = torch.from_numpy(np.concatenate([angles, generator.normal(0, 1, len(joints))]))
        wanted = axes_and_place(of, angles, site)
        np.testing.assert_allclose(match(state).numpy(), wanted, atol=1e-12)
        np.testing.assert_allclose(place(state).numpy(), wanted[:3], atol=1e-12)


def test_joints_beyond_the_site_have_no_part_in_it() -> None:
    match = site_match(robot("a", "d"), "near")
    assert not match.angles[:, 1].any()


def test_site_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="match must be one of the sites near, tip, got 'hand'"):
        site_match(robot("a"), "hand")


def test_slide_on_the_way_is_refused() -> None:
    with pytest.raises(ValueError, match="needs hinges on the way to it, got the slide s"):
        site_match(robot("a", "s"), "tip")
