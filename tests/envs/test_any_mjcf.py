"""Models of all kinds: the whole start, which actuators are actions, their units and names."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.tasks.site_match import site_match

KEYS = """<keyframe>
  <key name="a" qpos="0.5 .02 .02 .8 .2 .03 1 0 0 0" ctrl="1 0 .02" mpos="3 0 1"/>
  <key name="b" qpos="0.1 .03 .03 .7 .2 .03 1 0 0 0"/>
</keyframe>"""
GRIPPER = """
<mujoco model="gripper">
  <compiler angle="radian"/>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body name="goal" mocap="true"/>
    <body name="arm">
      <joint name="turn" axis="0 0 1" damping="1"/>
      <geom type="capsule" fromto="0 0 1 .3 0 1" size=".02" mass="1"/>
      <body pos=".3 .1 1">
        <joint name="left" type="slide" axis="0 1 0" range=".01 .04" damping="5"/>
        <geom size=".01" mass=".1"/>
      </body>
      <body pos=".3 -.1 1">
        <joint name="right" type="slide" axis="0 -1 0" range=".01 .04" damping="5"/>
        <geom size=".01" mass=".1"/>
        <site name="pad"/>
      </body>
    </body>
    <body pos="1 0 .03"><freejoint/><geom size=".03" mass=".1"/></body>
  </worldbody>
  <tendon>
    <fixed name="split"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed>
  </tendon>
  <equality><joint joint1="right" joint2="left"/></equality>
  <actuator>
    <position name="servo" joint="turn" kp="30" kv="5" gear="2" ctrlrange="-3 3"/>
    <motor joint="turn" ctrlrange="-5 5"/>
    <position name="grip" tendon="split" kp="200" ctrlrange="0 .04"/>
  </actuator>
  <sensor><framepos objtype="body" objname="goal"/></sensor>
  {keys}
</mujoco>
"""
WITH_KEYS = GRIPPER.format(keys=KEYS)
BASE = """
<mujoco>
  <worldbody><body name="b">
    <joint name="x" type="slide"/><joint name="y" type="slide" axis="0 1 0"/>
    <joint name="th" axis="0 0 1"/><geom size=".1" mass="1"/><site name="c"/>
  </body></worldbody>
  <actuator>{}</actuator>
</mujoco>
"""
URDF = """<robot name="u"><link name="base"/>
<link name="l"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="12" velocity="1"/></joint></robot>"""


def physics_after(robot: MujocoRobot, action: float, steps: int) -> Tensor:
    env = robot()
    env.rollout(steps, lambda state: torch.tensor([action]).double())
    return env.state_dict()["_physics"][0]


def test_keyframe_is_the_whole_start() -> None:
    robot = MujocoRobot(WITH_KEYS, ["turn"], ["servo"], start_std=0.0)
    env = robot()
    env.reset()
    expected = [0.0, 0.5, 0.02, 0.02, 0.8, 0.2, 0.03, 1.0, 0.0, 0.0, 0.0] + [0.0] * 9
    assert env.state_dict()["_physics"][0].tolist() == expected
    assert env.model.body("goal").pos.tolist() == [3.0, 0.0, 1.0]


@pytest.mark.parametrize(("start", "fingers"), [(None, 0.02), ("b", 0.03), (1, 0.03)])
def test_actuators_that_are_no_actions_keep_the_start(start: str | None, fingers: float) -> None:
    """By the keyframe's controls, or, without, by those that point to where the servos are."""
    robot = MujocoRobot(WITH_KEYS, ["turn"], ["servo"], start=start)
    after = physics_after(robot, 1.0, 60)
    assert after[2:4].tolist() == pytest.approx([fingers] * 2, abs=1e-3)


def test_servo_with_a_gear_keeps_its_name_and_is_held_by_its_own_angle() -> None:
    robot = MujocoRobot(WITH_KEYS, ["turn"], ["servo"])
    assert robot().action_names == ("servo",) and robot().action_units == ("0.5 rad",)
    assert robot.held(robot.initial_mean).tolist() == [1.0]
    assert physics_after(robot, 1.0, 60)[1].item() == pytest.approx(0.5, abs=1e-3)


def test_hidden_mimic_joint_starts_where_the_observed_one_is() -> None:
    robot = MujocoRobot(WITH_KEYS, ["turn", "left"], ["servo", "grip"], start_std=0.01)
    env = robot(num_envs=20, seed=0)
    env.reset()
    physics = env.state_dict()["_physics"]
    assert physics[:, 2].std() > 0.003
    torch.testing.assert_close(physics[:, 3], physics[:, 2], rtol=0, atol=1e-9)
    torch.testing.assert_close(physics[:, 13], physics[:, 12], rtol=0, atol=1e-9)
    assert physics[:, 2].min() >= 0.01 and physics[:, 2].max() <= 0.04


NAMES = [
    (
        '<motor joint="x" ctrlrange="-1 1"/><velocity name="v" joint="y" kv="3" ctrlrange="-1 1"/>'
        '<motor joint="th" gear="50" ctrlrange="-1 1"/>',
        (("motor of x", "N"), ("v", "m/s"), ("motor of th", "50 N·m")),
    ),
    (
        '<motor name="th" joint="th" ctrlrange="-1 1"/>'
        '<position name="p" joint="th" kp="2" ctrlrange="-1 1"/>'
        '<position joint="y" kp="2" ctrlrange="-1 1"/>',
        (("th", "N·m"), ("p", "rad"), ("y", "m")),
    ),
    (
        '<motor site="c" gear="0 0 0 0 0 1" ctrlrange="-1 1"/><adhesion body="b" ctrlrange="0 1"/>'
        '<position joint="x" kp="9" timeconst=".1" ctrlrange="-1 1"/>'
        '<intvelocity joint="y" kp="9" ctrlrange="-1 1" actrange="-1 1"/>',
        (("motor of c", "N·m"), ("motor of b", "N"), ("x", "m"), ("rate of y", "m/s")),
    ),
]


@pytest.mark.parametrize(("actuators", "expected"), NAMES)
def test_names_and_units_are_those_of_what_is_moved(actuators: str, expected: tuple) -> None:
    env = MujocoRobot(BASE.format(actuators), ["x", "y", "th"])()
    assert tuple(zip(env.action_names, env.action_units, strict=True)) == expected
    assert env.rollout(3)["next", "observation"].isfinite().all()


def test_actuators_are_chosen_by_their_joint_and_a_motor_is_not_held() -> None:
    xml = BASE.format('<motor joint="x" ctrlrange="-1 1"/><position joint="th" ctrlrange="-2 2"/>')
    robot = MujocoRobot(xml, ["x", "y", "th"], {"th": (-1.0, 0.5)})
    assert robot().action_names == ("th",) and robot().action_spec.space.high.tolist() == [0.5]
    assert robot.held(torch.arange(6.0).double()).tolist() == [2.0]
    assert MujocoRobot(xml, ["x", "y", "th"], ["x"]).held is None


def test_time_step_is_the_next_shorter_one_that_divides() -> None:
    with pytest.warns(RuntimeWarning, match=r"^time step 1.9608 ms \(the model's is 2 ms\), so t"):
        robot = MujocoRobot(WITH_KEYS, ["turn"], rate=30)
    assert robot.model.opt.timestep == pytest.approx(1 / 30 / 17, rel=1e-12)
    assert robot().substeps == 17
    assert MujocoRobot(WITH_KEYS, ["turn"], rate=25).model.opt.timestep == 0.002


def test_site_is_matched_with_hidden_joints_where_they_start() -> None:
    robot = MujocoRobot(WITH_KEYS, ["turn"], ["servo"])
    place = site_match(robot, "pad")(torch.tensor([math.pi / 2, 0.0], dtype=torch.float64))
    assert place.tolist() == pytest.approx([0.12, 0.3, 1.0], abs=1e-12)
    with pytest.raises(ValueError, match="got right, which follows others by an equality"):
        site_match(MujocoRobot(WITH_KEYS, ["left"]), "pad")


def test_range_in_degrees_is_named() -> None:
    xml = BASE.format('<position joint="th" ctrlrange="-90 90"/>')
    with pytest.warns(
        RuntimeWarning, match="range of actuator th is in rad.* -90 to 90 looks like"
    ):
        MujocoRobot(xml, ["th"])
    assert MujocoRobot(xml, ["th"], {"th": (-math.pi, math.pi)})


REFUSED = [
    (WITH_KEYS, ["left", "right"], {}, "equalities of the model tie left and right: leave one"),
    (WITH_KEYS, ["turn"], {"start": "c"}, "start must be one of the model's keyframes, a, b, got"),
    (GRIPPER.format(keys=""), ["turn"], {}, "got 0 m for left, whose range is 0.01 to 0.04 m"),
    (WITH_KEYS, ["turn"], {"actions": ["turn"]}, "must each be one actuator, got turn for 2"),
    (WITH_KEYS, ["turn"], {"actions": []}, "must be at least one of servo, turn, grip, got none"),
    (WITH_KEYS, ["turn"], {"actions": {"servo": (1, -1)}}, "a lowest and a highest action, got"),
    (WITH_KEYS, ["turn", "turn"], {}, "joints must be different ones, got turn, turn"),
    (URDF, ["j1"], {}, r'must have actuators, got none.* <motor joint="j1" ctrlrange="-12 12"/>'),
    ("<mujoco/>", ["x"], {}, "joints must be hinges and slides among those with names, got x"),
    (
        BASE.format('<motor joint="x"/>'),
        ["x"],
        {},
        r"got none: give one in the file, or actions=\{",
    ),
]


@pytest.mark.parametrize(("xml", "joints", "settings", "message"), REFUSED)
def test_what_cannot_be_right_is_one_line(
    xml: str, joints: list[str], settings: dict, message: str
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        MujocoRobot(xml, joints, **settings)
    assert "\n" not in str(caught.value)
