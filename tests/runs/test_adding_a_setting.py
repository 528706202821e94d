"""Adding a setting takes one line, its declaration; everything else reads it there."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import torch_pmil

PACKAGE = Path(torch_pmil.__file__).parent
BEFORE = "    initial_weight_std: float = setting("
LINE = '    sway: float = setting(0.5, "how far it sways", above=0, most=2, unit="sways")\n'
PROGRAM = """
import json
from pathlib import Path
from torch_pmil.cli.train import help_of
from torch_pmil.runs.report.tables import tables
from torch_pmil.runs.run_folder import write_settings
from torch_pmil.runs.settings import documentation_rows, with_file
from torch_pmil.tasks.registry import load_experiment

def refused(value):
    try:
        load_experiment("double_pendulum").with_settings(sway=value)
    except ValueError as error:
        return str(error)

task = load_experiment("double_pendulum").with_settings(sway=1.5)
write_settings(Path("."), task.adjustable)
summary = {"trials": [], "saved_n_eval": 20, "settings": task.settings}
shown = next(table for table in tables(summary) if table.title == "Settings")
print(json.dumps({
    "help": help_of(with_file(["settings=settings.yaml"])),
    "refused": [refused(value) for value in (3.0, 0, "far", True)],
    "summary": task.settings["sway"],
    "report": [row for row in shown.rows if row[0] == "sway"],
    "rows": [row for row in documentation_rows() if "sway" in row],
}))
"""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What a copy of the package with one line more knows of the setting."""
    folder = tmp_path_factory.mktemp("copy")
    ignored = shutil.ignore_patterns("__pycache__", "*.npz", "*.so", "learned")
    shutil.copytree(PACKAGE, folder / "torch_pmil", ignore=ignored)
    shown = "demonstrations/data/double_pendulum.npz"
    shutil.copy(PACKAGE / shown, folder / "torch_pmil" / shown)
    method = folder / "torch_pmil" / "tasks" / "method.py"
    method.write_text(method.read_text().replace(BEFORE, LINE + BEFORE))
    environment = os.environ | {"PYTHONPATH": str(folder)}
    printed = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=folder,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    return json.loads(printed)


def test_it_is_read_from_a_file_and_is_in_the_help_and_the_documentation(seen: dict) -> None:
    words = "how far it sways (above 0, at most 2; unit: sways)"
    assert f"  sway=1.5\n      {words}\n" in seen["help"]
    assert seen["rows"] == ["| `sway` | how far it sways | above 0, at most 2 | sways |"]


def test_it_is_in_summary_and_report(seen: dict) -> None:
    assert seen["summary"] == 1.5
    assert seen["report"] == [["sway", "1.5", "sways"]]


def test_it_is_refused_out_of_range_in_one_line_that_names_it(seen: dict) -> None:
    line = "sway must be a finite number, above 0, at most 2, got"
    assert seen["refused"] == [f"{line} {got}" for got in ("3.0", "0", "'far'", "True")]
