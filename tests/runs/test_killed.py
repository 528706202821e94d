"""Runs that are killed at some file operations, in a process of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = "tests/runs/test_killed_anywhere.py"
TESTS = (
    "test_run_that_is_killed_goes_on_to_the_same_files",
    "test_run_that_is_killed_again_and_again_goes_on_to_the_same_files",
    "test_second_run_is_told_of_the_first_as_long_as_that_lives",
)


def test_runs_that_are_killed_go_on() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-m", "", "-p", "no:cacheprovider"]
    command += [f"{FILE}::{name}" for name in TESTS]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 0 and f"{len(TESTS)} passed" in ended.stdout, ended.stdout
