"""Kernels and intrinsics in the API reference: autodoc shows functions, and these are objects."""

from __future__ import annotations

import importlib
import sys

from sphinx.application import Sphinx

ROOM = "torch_pmil.model.compiled."


def show_functions(app: Sphinx) -> None:
    """Put the functions that Numba compiles in the place of what it makes of them."""
    importlib.import_module(ROOM + "prediction")
    for name in [name for name in sys.modules if name.startswith(ROOM)]:
        objects = vars(sys.modules[name])
        wrapped = {key: getattr(value, "__wrapped__", None) for key, value in objects.items()}
        objects.update((key, value) for key, value in wrapped.items() if value is not None)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("builder-inited", show_functions)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
