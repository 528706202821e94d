"""A picture of the set-up with several targets: robot, balls and region (Figure 11 (a))."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from torch import Tensor

from torch_pmil.envs.biorob import STRING, biorob_model
from torch_pmil.envs.hitting_plane import GRID, TRAINING_TARGETS, ball_at
from torch_pmil.envs.mujoco_model import open_renderer

BLUE, CLEAR_BLUE = (0.0, 0.447, 0.698, 1.0), (0.0, 0.447, 0.698, 0.25)
FRAME = 0.005  # m, radius of the region's edges
THICKNESS = 0.001  # m
# the camera looks from the front, at the robot's right
LOOK_AT, DISTANCE = (0.42, 0.0, 0.86), 2.0  # m
AZIMUTH, ELEVATION = 140.0, -14.0  # degrees


def draw_targets(
    targets: Tensor = TRAINING_TARGETS,
    region: Tensor = GRID,
    pixel_size: tuple[int, int] = (600, 800),
) -> np.ndarray:
    """Draw the robot at its start, a ball on its string at each target, and a region's rectangle.

    Args:
        targets: [y, z] of the balls, (N, 2), m.
        region: points in the plane, (R, 2), m; the rectangle is the least one that holds all of
            them.
        pixel_size: height and width of the picture.

    Returns:
        The picture (height, width, 3), uint8.

    Raises:
        RuntimeError: OpenGL is not available.

    Example:
        >>> draw_targets().shape  # doctest: +SKIP
        (600, 800, 3)
    """
    first, *others = ball_at(targets)
    model = biorob_model(first)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    data.joint("ball").qpos[:3] = first
    mujoco.mj_forward(model, data)
    with open_renderer(model, pixel_size) as renderer:
        renderer.update_scene(data, _camera())
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        for place in others:
            _add_ball(renderer.scene, model, place.numpy())
        low, high = ball_at(region.amin(0)).numpy(), ball_at(region.amax(0)).numpy()
        _add_rectangle(renderer.scene, low, high)
        return renderer.render()


def _camera() -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = LOOK_AT, DISTANCE
    camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
    return camera


def _add_ball(scene: mujoco.MjvScene, model: mujoco.MjModel, place: np.ndarray) -> None:
    """Add a ball like the model's own, and its string."""
    size = np.repeat(model.geom("ball").size[:1], 3)
    _add(scene, mujoco.mjtGeom.mjGEOM_SPHERE, model.mat("ball").rgba, size, place)
    knot, ceiling = place + model.site("knot").pos, place + np.array([0.0, 0.0, STRING])
    width = model.tendon_width[model.tendon("string").id]
    _add_line(scene, model.mat("string").rgba, width, knot, ceiling)


def _add_rectangle(scene: mujoco.MjvScene, low: np.ndarray, high: np.ndarray) -> None:
    """Add a clear rectangle between two corners of the plane, and its edges."""
    size = (high - low) / 2 + np.array([THICKNESS, 0.0, 0.0])
    _add(scene, mujoco.mjtGeom.mjGEOM_BOX, CLEAR_BLUE, size, (low + high) / 2)
    corners = np.array([low, [low[0], high[1], low[2]], high, [low[0], low[1], high[2]]])
    for start, end in zip(corners, np.roll(corners, -1, 0), strict=True):
        _add_line(scene, BLUE, FRAME, start, end)


def _add(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    colour: Sequence[float],
    size: np.ndarray,
    place: np.ndarray,
) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    rgba = np.asarray(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).flatten(), rgba)
    scene.ngeom += 1
    return geom


def _add_line(
    scene: mujoco.MjvScene,
    colour: Sequence[float],
    radius: float,
    start: np.ndarray,
    end: np.ndarray,
) -> None:
    geom = _add(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, colour, np.zeros(3), start)
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
