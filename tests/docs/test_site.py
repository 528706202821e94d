"""The documentation builds without a warning, and says what is wrong where it is not right."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx", reason="needs the extra docs")
pytest.importorskip("myst_nb", reason="needs the extra docs")

ROOT = Path(__file__).parents[2]


def build(source: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """What ``make docs`` runs; the notebooks have a test of their own."""
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-q", "-W", "--keep-going", "-E", "-c", "docs", "-D", "nb_execution_mode=off"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run([*command, source, out], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_documentation_builds_without_a_warning(tmp_path: Path) -> None:
    built = build(ROOT / "docs", tmp_path)
    assert (built.returncode, built.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("{code}`torch_pmil.kl.gaussian_kl`", ""),
        ("{code}`torch_pmil.kl.no_such_function`", "no such object in the API reference: torch_pmil.kl.no_such_function"),
        ("{code}`torch_pmil.gaussian.Gaussian`", "no such object in the API reference: torch_pmil.gaussian.Gaussian"),
        ("[a link](#nowhere)", "nowhere"),
        ("[a file](nowhere.md)", "nowhere.md"),
        ("![a picture](nowhere.png)", "nowhere.png"),
    ],
)
def test_link_that_leads_nowhere_fails_the_build(page: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    equations = "\n\n".join(f"$$x \\tag{{{number}}}$$" for number in (8, 19, 20, 23, 24))
    text = f"# A page\n\n{page}\n\n```{{eval-rst}}\n.. automodule:: torch_pmil.kl\n```\n\n```{{toctree}}\nmethod\n```\n"
    (tmp_path / "docs" / "index.md").write_text(text)
    (tmp_path / "docs" / "method.md").write_text(f"# Equations\n\n{equations}\n")
    built = build(tmp_path / "docs", tmp_path / "html")
    assert (built.returncode == 0) == (not said), built.stderr
    assert said in built.stderr
