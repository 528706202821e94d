"""The backend by which MuJoCo draws, chosen even after another package imported MuJoCo."""

from __future__ import annotations

import ctypes.util
import importlib
import os
from pathlib import Path

import pytest

from torch_pmil.envs import opengl

GIVEN = "MUJOCO_GL"


@pytest.mark.parametrize(
    ("display", "given", "egl", "chosen"),
    [
        (None, None, "libEGL.so.1", "egl"),
        (None, None, None, ""),
        (":0", None, "libEGL.so.1", ""),
        (None, "osmesa", "libEGL.so.1", "osmesa"),
    ],
)
def test_egl_is_chosen_without_a_display_unless_another_is_given(
    display: str | None,
    given: str | None,
    egl: str | None,
    chosen: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (("DISPLAY", display), (GIVEN, given)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    monkeypatch.setattr(ctypes.util, "find_library", {"EGL": egl}.get)
    assert opengl.chosen_backend() == chosen


def test_backend_is_read_anew_if_mujoco_was_imported_before(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "reads_backend.py").write_text(f"import os\nread = os.environ.get('{GIVEN}')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(GIVEN, "glfw")
    monkeypatch.setattr(opengl, "READER", "reads_backend")
    reader = importlib.import_module("reads_backend")
    opengl.import_mujoco("egl")
    assert reader.read == os.environ[GIVEN] == "egl"
    reader.read = "kept"
    opengl.import_mujoco("egl")  # nothing new to read
    opengl.import_mujoco("")  # left to MuJoCo
    assert reader.read == "kept" and os.environ[GIVEN] == "egl"
