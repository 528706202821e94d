"""How the tests execute the notebooks: each in a process of its own, one thread each, the long ones
only when all tests are asked for.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SLOW = {"01_swing_up.ipynb", "06_targets.ipynb"}  # longer than a minute, as they say at their top
ROOT = Path(__file__).parents[1]


def pytest_configure() -> None:
    """Kernels import the package that is tested, not one that is installed."""
    os.environ["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
    )
    os.environ["OMP_NUM_THREADS"] = "1"


@pytest.hookimpl(tryfirst=True)  # before the slow ones are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the long ones."""
    for item in items:
        if item.path.name in SLOW:
            item.add_marker(pytest.mark.slow)
