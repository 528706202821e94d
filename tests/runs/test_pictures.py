"""Films that take too long, and the light in which an own robot is seen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torch_pmil.envs.mujoco_robot import CAMERA_DISTANCE, MujocoRobot
from torch_pmil.runs import pictures
from torch_pmil.runs.pictures import TooSlowError, film_or_picture, timely

BLACK = np.zeros((8, 8, 3), dtype=np.uint8)
SLIDER = """
<mujoco>
  <worldbody>
    <geom type="plane" size="50 50 1"/>
    <body pos="1 0 0">
      <joint name="x" type="slide" axis="1 0 0" range="-2 2"/>
      <geom type="sphere" size="0.5"/>
    </body>
  </worldbody>
  <actuator><motor joint="x" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def ticking(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let each look at the clock of the processor cost so much."""
    clock = iter(np.arange(1000) * seconds)
    monkeypatch.setattr(pictures.time, "process_time", lambda: next(clock))


def test_quick_pictures_all_come(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 0.1)
    assert len(list(timely(iter([BLACK] * 50)))) == 50


def test_slow_pictures_end_after_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 3.0)
    came: list[np.ndarray] = []
    with pytest.raises(TooSlowError, match="4 pictures took 12 s of computing"):
        came.extend(timely(iter([BLACK] * 50)))


def test_one_picture_takes_the_place_of_a_film_that_is_too_slow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def film(task: Any, result: Any, path: Path) -> Iterator[None]:
        raise TooSlowError("no video: too slow")

    monkeypatch.setattr(pictures, "film", film)
    (tmp_path / "figures").mkdir()
    robot = SimpleNamespace(initial_mean=0, render=lambda state: BLACK)
    task: Any = SimpleNamespace(first_robot=lambda seed: robot)
    film_or_picture(task, None, tmp_path)  # type: ignore[arg-type]
    assert (tmp_path / "figures/robot.png").read_bytes()[:4] == b"\x89PNG"
    assert not (tmp_path / "video.mp4").exists()
    assert "figures/robot.png" in capsys.readouterr().out


def test_added_camera_sees_what_moves_as_far_as_it_slides_and_not_the_floor() -> None:
    model = MujocoRobot(SLIDER, ["x"]).model
    place = model.camera("front").pos
    radius = np.sqrt(3) * 0.5 + 2.0  # of the box around the sphere, and of the joint
    assert np.linalg.norm(place - [1, 0, 0]) == pytest.approx(CAMERA_DISTANCE * radius)
    assert model.vis.headlight.ambient.min() >= 0.4
