"""The documentation builds without a warning, and the build says what is wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

for package in ("sphinx", "myst_nb", "sphinx-mathjax-offline"):
    pytest.importorskip(package, reason="needs the extra docs")

ROOT = Path(__file__).parents[2]
UNKNOWN = "no such object in the API reference: torch_pmil."
FLAWS = {
    "{code}`torch_pmil.gp.gaussian.no_such_function`": f"{UNKNOWN}gp.gaussian.no_such_function",
    "{code}`torch_pmil.search.kl.gaussian_kl`": f"{UNKNOWN}search.kl.gaussian_kl",
    "{py:func}`no_such_reference`": "py:func reference target not found: no_such_reference",
    "{result}`paper/box {no_such_number}`": "{no_such_number}: 'no_such_number'",
    "```{results} paper/box\na row: {no_such_entry}\n```": "paper/box has no entries for ['a row'",
    "[an anchor](#no-such-heading)": "no-such-heading",
    "[a page](no_such_page.md)": "no_such_page.md",
    "![a picture](no_such_picture.png)": "no_such_picture.png",
    "<a href='no_such_file.html'>a link</a>": "broken link in index.html: no_such_file.html",
}


def build(source: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """What ``make docs`` runs; the notebooks have a test of their own."""
    command = f"{sys.executable} -m sphinx -b html -q -W --keep-going -E -c docs"
    return subprocess.run(
        [*command.split(), "-D", "nb_execution_mode=off", source, out],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_documentation_builds_without_a_warning_and_needs_no_network_and_links_equations_to_code(
    tmp_path: Path,
) -> None:
    built = build(ROOT / "docs", tmp_path)
    assert (built.returncode, built.stderr) == (0, "")
    page = (tmp_path / "start" / "method.html").read_text()
    assert 'src="../_static/tex-svg.js' in page  # nothing is asked of a network for equations
    assert (tmp_path / "_static" / "tex-svg.js").stat().st_size > 1_000_000
    assert 'src="http' not in page
    assert 'href="../_modules/torch_pmil/search/kl.html#gaussian_kl"' in page
    assert 'href="../start/method.html#eq-19"' in (tmp_path / "api" / "search.html").read_text()
    assert "Of earlier sources" in (tmp_path / "how_to" / "gpu.html").read_text()  # needs a GPU


@pytest.mark.slow
def test_what_leads_nowhere_fails_the_build_and_is_named(tmp_path: Path) -> None:
    whole = "# A page\n\n```{eval-rst}\n.. automodule:: torch_pmil.gp.gaussian\n```"
    link = "{code}`torch_pmil.gp.gaussian.Gaussian`"
    (tmp_path / "index.md").write_text("\n\n".join([whole, link, *FLAWS]))
    built = build(tmp_path, tmp_path / "html")
    assert built.returncode != 0
    assert not [said for said in FLAWS.values() if said not in built.stderr], built.stderr
    assert "torch_pmil.gp.gaussian.Gaussian" not in built.stderr
