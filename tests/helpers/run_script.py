"""Commands and scripts run inside the test's process, so that it can patch what they import."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

from torch_pmil import cli

ROOT = Path(__file__).parents[2]


def run_command(patch: pytest.MonkeyPatch, *arguments: object) -> None:
    """Run ``pmil`` as a command line with these arguments would."""
    patch.setattr(sys, "argv", ["pmil", *map(str, arguments)])
    cli.main()


def run_script(patch: pytest.MonkeyPatch, script: str, *arguments: object) -> None:
    """Run a script, a path in the repository, as a command line with these arguments would."""
    path = str(ROOT / script)
    patch.setattr(sys, "argv", [path, *map(str, arguments)])
    runpy.run_path(path, run_name="__main__")
