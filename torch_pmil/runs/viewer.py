"""MuJoCo's viewer: a window that shows motions one after the other in real time."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from typing import Any

import mujoco
from torch import Tensor

from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.mujoco_model import FULL_PHYSICS

REST = 1.0  # s, between two motions
PERIOD = 1 / 60  # s, between two pictures


def has_screen() -> bool:
    """Whether a window with OpenGL can be opened; without one, MuJoCo's viewer waits for ever.

    False on macOS, where the viewer needs an interpreter of its own, ``mjpython``.
    """
    if sys.platform == "darwin":
        return False
    try:
        glfw = import_module("glfw")
    except ImportError:
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not glfw.init():
            return False
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "", None, None)
        glfw.default_window_hints()
        if window:
            glfw.destroy_window(window)
    return bool(window)


def show(env: MujocoRobotEnv, replays: Iterator[Tensor]) -> None:
    """Show one motion after the other, until the window is closed or Ctrl-C is pressed.

    The replays are the full simulation states (K, P) of each motion, see ``env.replay``.
    """
    data = mujoco.MjData(env.model)
    launch = import_module("mujoco.viewer").launch_passive
    viewer = launch(env.model, data, show_left_ui=False, show_right_ui=False)
    with viewer, suppress(KeyboardInterrupt):
        with viewer.lock():
            viewer.cam.type = mujoco.mjtCamera.mjCAMERA_FIXED
            viewer.cam.fixedcamid = env.model.camera(env.camera).id
        for replay in replays:
            if not _played(env, viewer, data, replay):
                return


def _played(env: MujocoRobotEnv, viewer: Any, data: mujoco.MjData, replay: Tensor) -> bool:
    """Show a motion and rest on its last pose; return whether the window is still open."""
    begin, timestep = time.monotonic(), env.model.opt.timestep
    duration = timestep * (len(replay) - 1)
    while viewer.is_running() and (elapsed := time.monotonic() - begin) < duration + REST:
        physics = replay[round(min(elapsed, duration) / timestep)]
        with viewer.lock():
            mujoco.mj_setState(env.model, data, physics.numpy(), FULL_PHYSICS)
            mujoco.mj_forward(env.model, data)
        viewer.sync()
        time.sleep(PERIOD)
    return viewer.is_running()
