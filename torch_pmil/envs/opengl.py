"""MuJoCo, imported so that it draws pictures without a display."""

from __future__ import annotations

import ctypes.util
import importlib
import os
import sys

READER = "mujoco.rendering.classic.gl_context"  # reads MUJOCO_GL once


def chosen_backend() -> str:
    """What ``MUJOCO_GL`` says, or else EGL if there is no display; "" leaves it to MuJoCo."""
    headless = "DISPLAY" not in os.environ and ctypes.util.find_library("EGL")
    return os.environ.get("MUJOCO_GL", "egl" if headless else "")


def import_mujoco(backend: str) -> None:
    """Import MuJoCo with a backend of OpenGL, even if it was imported before, as TorchRL does.

    Raises:
        RuntimeError, AttributeError, OSError: the backend is misspelt or broken.
    """
    if backend and os.environ.get("MUJOCO_GL") != backend:
        os.environ["MUJOCO_GL"] = backend
        if READER in sys.modules:
            importlib.reload(sys.modules[READER])
    importlib.import_module("mujoco")
