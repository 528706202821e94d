"""Notebooks as they are kept: without outputs, in reading order, saying what they are;
``notebooks/conftest.py`` has them executed.
"""

from __future__ import annotations

import os
import re
import runpy
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

import torch_pmil

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
CONFTEST = runpy.run_path(str(FOLDER / "conftest.py"))
WHERE = """
import importlib.util, os
print(importlib.util.find_spec("torch_pmil").origin, os.environ["OMP_NUM_THREADS"])
"""

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> NotebookNode:
    """As it is in the file, nothing added."""
    return nbformat.read(path, nbformat.NO_CONVERT)


def text_of(path: Path, kind: str) -> str:
    return "\n".join(cell.source for cell in read(path).cells if cell.cell_type == kind)


def test_names_count_up_in_reading_order() -> None:
    assert [path.name[:3] for path in NOTEBOOKS] == [
        f"{number:02d}_" for number in range(1, len(NOTEBOOKS) + 1)
    ]


@each_notebook
def test_outputs_are_stripped(path: Path) -> None:
    code = [cell for cell in read(path).cells if cell.cell_type == "code"]
    assert code and all(cell.outputs == [] and cell.execution_count is None for cell in code)


@each_notebook
def test_notebook_is_of_the_newest_format_for_any_python(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor, notebook.metadata.kernelspec.name) == (
        4,
        5,
        "python3",
    )
    assert [cell.id for cell in notebook.cells] == [
        str(number) for number in range(len(notebook.cells))
    ]  # as nbstripout numbers them


@each_notebook
def test_opening_says_how_long_it_runs_and_more_than_a_minute_is_slow(path: Path) -> None:
    opening = read(path).cells[0].source
    assert re.match(r"# .+\n\nYou will see .+ It runs in about .+", opening, re.DOTALL)
    assert (path.name in CONFTEST["SLOW"]) == ("minutes" in opening)


@each_notebook
def test_links_lead_somewhere_and_on(path: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", text_of(path, "markdown"))
    assert not [
        link for link in links if not link.startswith("http") and not (FOLDER / link).exists()
    ]
    assert "## What next" in read(path).cells[-1].source


@each_notebook
def test_figures_are_drawn_by_the_package(path: Path) -> None:
    """Its functions label their axes, as their own tests say."""
    code = text_of(path, "code")
    assert "torch_pmil.plotting import" in code
    assert not re.search(r"^\s*(import|from) (matplotlib|pylab|seaborn)", code, re.MULTILINE)


def test_slow_notebooks_are_there() -> None:
    assert CONFTEST["SLOW"] <= {path.name for path in NOTEBOOKS}


def test_kernels_import_the_package_under_test_on_one_thread(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("PYTHONPATH", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "")
    CONFTEST["pytest_configure"]()
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(WHERE)])
    NotebookClient(
        notebook, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    origin, threads = notebook.cells[0].outputs[0].text.split()
    assert os.path.samefile(origin, torch_pmil.__file__)
    assert threads == "1"
