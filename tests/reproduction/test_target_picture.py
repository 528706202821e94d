"""The picture of the set-up shows each ball and the region around them, or needs OpenGL."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PICTURES = """
import numpy as np
import torch
from scipy.ndimage import label
from torch_pmil.envs.hitting_plane import GRID, TRAINING_TARGETS
from reproduction.target_picture import draw_targets

def balls(picture):
    red, green, blue = picture.astype(int).transpose(2, 0, 1)
    # orange: the racket and its handle are redder
    regions, count = label((red > 150) & (blue < 90) & (green > 0.5 * red))
    regions_of = (regions == index for index in range(1, count + 1))
    return [np.argwhere(region).mean(0) for region in regions_of if region.sum() > 50]

def clear_blue(picture):
    return int((picture[..., 2].astype(int) > picture[..., 0].astype(int) + 40).sum())

shown = draw_targets()
assert shown.shape == (600, 800, 3) and shown.dtype == np.uint8
assert len(balls(shown)) == 3 and len(balls(draw_targets(TRAINING_TARGETS[:1]))) == 1
top, *lower = sorted(balls(shown), key=lambda place: place[0])
left, right = sorted(lower, key=lambda place: place[1])
assert left[1] < top[1] < right[1]
assert clear_blue(shown) > 3 * clear_blue(draw_targets(region=GRID / 3)) > 0
assert draw_targets(pixel_size=(60, 80)).shape == (60, 80, 3)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "fails"), [("egl", False), ("glfw", True)])
def test_picture_shows_every_ball_and_the_region_or_is_refused_clearly(
    backend: str, fails: bool
) -> None:
    environment = {name: os.environ[name] for name in os.environ if "DISPLAY" not in name}
    command = [sys.executable, "-W", "ignore", "-c", PICTURES]
    given = environment | {"MUJOCO_GL": backend}
    result = subprocess.run(command, env=given, capture_output=True, text=True, check=False)
    assert (result.returncode != 0) == fails, result.stderr
    complaint = "RuntimeError: pictures need OpenGL, which failed with MUJOCO_GL glfw"
    assert (complaint in result.stderr) == fails
