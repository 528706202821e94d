"""What the command lines of the benchmarks have in common."""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torch_pmil.files import write_json
from torch_pmil.runs.run_folder import provenance


def add_json(parser: argparse.ArgumentParser, name: str) -> None:
    """Add the option that names the file to write; by default the summary among the results."""
    default = Path(f"results/benchmarks/{name}/summary.json")
    parser.add_argument("--json", type=Path, default=default, help="file to write")


def source_of(name: str) -> dict[str, object]:
    """Where the numbers of ``python -m benchmarks.NAME`` come from, as a summary has it."""
    return provenance(shlex.join(["python", "-m", f"benchmarks.{name}", *sys.argv[1:]]))


def cpu_seconds(work: Callable[[], object]) -> float:
    """CPU seconds that a piece of work takes."""
    start = time.process_time()
    work()
    return time.process_time() - start


def write_summary(path: Path, summary: Mapping[str, object]) -> None:
    """Write what was measured, into a folder that may be new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, summary)


def row_of_own_process(name: str, *words: str) -> dict[str, Any]:
    """What ``python -m benchmarks.NAME WORDS`` prints as JSON in its last line.

    Raises:
        RuntimeError: it failed; the message has its last line.
    """
    command = [sys.executable, "-m", f"benchmarks.{name}", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{shlex.join(words)}: {done.stderr.strip().splitlines()[-1]}")
    row: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return row
