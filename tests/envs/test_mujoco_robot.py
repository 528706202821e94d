"""Robots of MJCF files without a class: their states, actions, starts and what they refuse."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from torch_pmil.envs.mujoco_robot import MujocoRobot

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.03" mass="1"/>
      <body name="lower" pos="0 0 0.4">
        <joint name="elbow" axis="0 1 0" damping="1" range="-2 2" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.03" mass="1"/>
        <body name="finger" pos="0 0 0.4">
          <joint name="grip" type="slide" range="0 0.1" limited="true"/>
          <geom size="0.02" mass="0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="servo1" joint="shoulder" kp="100" kv="20" ctrlrange="-3 3"/>
    <position name="servo2" joint="elbow" kp="100" kv="20" ctrlrange="-2 2"/>
    <motor name="gripper" joint="grip" ctrlrange="-5 5"/>
  </actuator>
  {keyframe}
</mujoco>
"""
KEYFRAME = '<keyframe><key name="home" qpos="0.3 -0.5 0"/></keyframe>'
JOINTS = ("shoulder", "elbow")


@pytest.fixture
def xml(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(keyframe=KEYFRAME))
    return path


def test_state_and_actions_are_named_by_the_joints_in_their_units(xml: Path) -> None:
    robot = MujocoRobot(xml, JOINTS, rate=20)
    assert robot.names == ("shoulder", "elbow", "dshoulder", "delbow")
    assert robot.units == ("rad", "rad", "rad/s", "rad/s")
    assert robot.turning == ("shoulder",)
    assert robot().action_names == ("shoulder", "elbow", "gripper")
    assert robot().action_units == ("rad", "rad", "N")
    slide = MujocoRobot(xml, ("elbow", "grip"), rate=20)
    assert slide.units == ("rad", "m", "rad/s", "m/s") and slide.turning == ()


def test_only_the_chosen_actuators_are_actions_in_their_ranges(xml: Path) -> None:
    chosen = {"servo2": (-1.0, 0.5), "servo1": (0.0, 1.0)}
    env = MujocoRobot(xml, JOINTS, chosen, rate=20)()
    assert env.action_names == JOINTS
    assert env.action_spec.space.low.tolist() == [0.0, -1.0]
    assert env.action_spec.space.high.tolist() == [1.0, 0.5]
    assert MujocoRobot(xml, JOINTS, ["gripper"], rate=20)().action_names == ("gripper",)


def test_starts_are_at_the_keyframe_or_where_it_is_said(xml: Path) -> None:
    assert MujocoRobot(xml, JOINTS).initial_mean.tolist() == [0.3, -0.5, 0.0, 0.0]
    robot = MujocoRobot(xml, JOINTS, start=[0.1, 0.2], start_std=[0.01, 0.02, 0.0, 0.0])
    starts = robot(num_envs=2000, seed=0).reset()["observation"]
    assert starts.mean(0).tolist() == pytest.approx([0.1, 0.2, 0.0, 0.0], abs=0.002)
    assert starts.std(0).tolist() == pytest.approx([0.01, 0.02, 0.0, 0.0], rel=0.1)
    xml.write_text(ARM.format(keyframe=""))
    assert MujocoRobot(xml, JOINTS).initial_mean.tolist() == [0.0] * 4


def test_servos_go_where_they_are_told(xml: Path) -> None:
    xml.write_text(xml.read_text().replace("<option", '<option gravity="0 0 0"'))
    env = MujocoRobot(xml, JOINTS, ["servo1", "servo2"], rate=50, start_std=0.0)()
    target = torch.tensor([0.6, -0.2], dtype=torch.float64)
    rollout = env.rollout(200, lambda state: target)
    last = rollout["next", "observation"][-1]
    torch.testing.assert_close(last[:2], target, atol=1e-3, rtol=0)
    torch.testing.assert_close(last[2:], torch.zeros_like(target), atol=1e-3, rtol=0)


def test_robot_of_a_specification_leaves_it_as_it_is(xml: Path) -> None:
    from mujoco import MjSpec  # after the package has chosen what it draws with

    spec = MjSpec.from_file(str(xml))
    MujocoRobot(spec, JOINTS, ["servo1"])
    assert [actuator.name for actuator in spec.actuators] == ["servo1", "servo2", "gripper"]
    assert not list(spec.cameras)


DRAWING = """
import sys
from torch_pmil.envs.mujoco_robot import MujocoRobot

robot = MujocoRobot(sys.argv[1], ("shoulder", "elbow"))
picture = robot().render(robot.initial_mean).astype(int)
rows, columns = (picture - picture[0, 0]).any(-1).nonzero()
print(picture.shape, len(rows), rows.min(), rows.max(), columns.min(), columns.max())
"""


def test_picture_shows_the_robot_though_its_file_has_no_camera(xml: Path) -> None:
    """In a process of its own, in which the package chooses what it draws with."""
    command = [sys.executable, "-c", DRAWING, str(xml)]
    drawn = subprocess.run(command, capture_output=True, text=True, check=False)
    if "pictures need OpenGL" in drawn.stderr:
        pytest.skip("OpenGL is not available")
    shape, *numbers = re.fullmatch(r"(\(.*\)) (.*)\n", drawn.stdout).groups()
    pixels, top, bottom, left, right = map(int, numbers[0].split())
    assert shape == "(480, 640, 3)"
    assert 0.005 < pixels / (480 * 640) < 0.3
    assert top > 0 and bottom < 479 and left > 0 and right < 639


REFUSED = [
    ({"joints": ("wrist",)}, ValueError, "joints must be hinges and slides among shoulder"),
    ({"joints": ()}, ValueError, "got none"),
    ({"actions": ["servo9"]}, ValueError, "actions must be actuators among servo1, servo2"),
    ({"rate": 0.0}, ValueError, "rate must be positive and finite, in Hz, got 0"),
    (
        {"rate": 30.0},
        RuntimeWarning,
        r"time step 0.98039 ms \(the model.s is 1 ms\), so that 34 steps",
    ),
    ({"start": [0.0]}, ValueError, "start must be 2 finite positions"),
    ({"start_std": [0.1, 0.1]}, ValueError, "initial_std must be 4 finite numbers"),
    ({"xml": 3}, TypeError, "xml must be a path, XML text or an MjSpec, got int"),
    ({"xml": "nowhere.xml"}, FileNotFoundError, "nowhere.xml"),
    ({"xml": "broken.xml"}, ValueError, "must be a model that MuJoCo reads"),
]


@pytest.mark.parametrize(("changes", "error", "message"), REFUSED)
def test_what_does_not_fit_is_refused(
    xml: Path,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict,
    error: type[Exception],
    message: str,
) -> None:
    monkeypatch.chdir(xml.parent)
    Path("broken.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(error, match=message):
        MujocoRobot(**({"xml": xml, "joints": JOINTS} | changes))
