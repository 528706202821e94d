"""What the command lines of the benchmarks have in common."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from torch_pmil.runs.run_folder import provenance


def add_json(parser: argparse.ArgumentParser, name: str) -> None:
    """Add the option that names the file to write; by default the summary among the results."""
    default = Path(f"results/benchmarks/{name}/summary.json")
    parser.add_argument("--json", type=Path, default=default, help="file to write")


def source_of(name: str) -> dict[str, object]:
    """Where the numbers of ``python -m benchmarks.NAME`` come from, as a summary has it."""
    return provenance(shlex.join(["python", "-m", f"benchmarks.{name}", *sys.argv[1:]]))
