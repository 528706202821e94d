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


def text_of(notebook: NotebookNode, kind: str) -> str:
    return "\n".join(cell.source for cell in notebook.cells if cell.cell_type == kind)


def test_names_count_up_in_reading_order_and_slow_ones_are_there() -> None:
    names = [path.name for path in NOTEBOOKS]
    assert [name[:3] for name in names] == [f"{n:02d}_" for n in range(1, len(names) + 1)]
    assert CONFTEST["SLOW"] <= {*names}


@each_notebook
def test_notebook_is_of_the_newest_format_for_any_python_and_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, nbformat.NO_CONVERT)  # nothing added
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    ids = [cell.id for cell in notebook.cells]
    assert ids == [str(number) for number in range(len(ids))]  # as nbstripout numbers them
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert code and all(cell.outputs == [] and cell.execution_count is None for cell in code)


@each_notebook
def test_notebook_says_what_it_shows_how_long_it_runs_and_where_to_go_on(path: Path) -> None:
    """What takes more than a minute is slow. Figures are drawn by the package, whose functions
    label their axes.
    """
    notebook = nbformat.read(path, nbformat.NO_CONVERT)
    opening, code = notebook.cells[0].source, text_of(notebook, "code")
    assert re.match(r"# .+\n\nYou will see .+ It runs in about .+", opening, re.DOTALL)
    assert (path.name in CONFTEST["SLOW"]) == ("minutes" in opening)
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", text_of(notebook, "markdown"))
    assert not [x for x in links if not x.startswith("http") and not (FOLDER / x).exists()]
    assert "## What next" in notebook.cells[-1].source
    assert "torch_pmil.plotting import" in code
    assert not re.search(r"^\s*(import|from) (matplotlib|pylab|seaborn)", code, re.MULTILINE)


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
