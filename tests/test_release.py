"""A release has one version and one date, and its archives hold what they should."""

from __future__ import annotations

import io
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable, Iterable
from configparser import ConfigParser
from datetime import date
from pathlib import Path

import pytest
import yaml

import torch_pmil
from tests.helpers.run_script import ROOT
from torch_pmil.runs.sweep import EXTRAS

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
CHANGES = (ROOT / "CHANGELOG.md").read_text()
RELEASES = re.findall(r"^## \[(.*)\] - (.*)$", CHANGES, re.MULTILINE)
SETTINGS = ConfigParser()
SETTINGS.read(ROOT / "setup.cfg")
NAMING = ("torch_pmil", "docs/start", "docs/how_to", "docs/results", "examples")
PACKAGE = {"torch_pmil/__init__.py", "torch_pmil/py.typed"}
TRACKED = PACKAGE | {"README.md", "tests/test_a.py"}
Check = Callable[[], None]


def test_version_is_the_same_everywhere() -> None:
    assert (
        torch_pmil.__version__
        == SETTINGS["metadata"]["version"]
        == CITATION["version"]
        == RELEASES[0][0]
    )


def test_extras_that_messages_and_pages_name_are_there() -> None:
    """As in ``pip install "torch_pmil[gym]"`` and ``pip install -e ".[dev]"``."""
    folders = [ROOT / folder for folder in NAMING]
    files = [
        path for folder in folders for kind in ("py", "md") for path in folder.rglob(f"*.{kind}")
    ]
    texts = [path.read_text() for path in (*files, ROOT / "README.md", ROOT / "CONTRIBUTING.md")]
    named = {
        extra
        for text in texts
        for names in re.findall(r'(?:torch_pmil|"\.)\[([a-z,]+)\]', text)
        for extra in names.split(",")
    }
    assert {"gym", "formats", "handwriting", "dev"} <= named
    assert named | {*EXTRAS.values()} <= SETTINGS["options.extras_require"].keys()


def test_libraries_that_messages_name_with_a_version_are_those_of_the_extras() -> None:
    texts = [path.read_text() for path in (ROOT / "torch_pmil").rglob("*.py")]
    named = {name for text in texts for name in re.findall(r"pip install (\w+==[\w.]+)", text)}
    extras = {
        line for extra in SETTINGS["options.extras_require"].values() for line in extra.split()
    }
    assert named and named <= extras


def test_page_about_installing_names_this_wheel_and_the_bounds_of_torch() -> None:
    page = (ROOT / "docs/start/install.md").read_text()
    (torch,) = re.findall(r"^torch[^r_].*$", SETTINGS["options"]["install_requires"], re.MULTILINE)
    assert f'pip install "{torch}" --index-url' in page
    assert f"torch_pmil-{torch_pmil.__version__}-py3-none-any.whl" in page


def test_release_is_dated_the_same_everywhere() -> None:
    assert date.fromisoformat(RELEASES[0][1]) == CITATION["date-released"]


def test_changes_are_told_release_by_release_the_newest_first_in_the_usual_sections() -> None:
    assert [day for _, day in RELEASES] == sorted((day for _, day in RELEASES), reverse=True)
    sections = set(re.findall(r"^### (.*)$", CHANGES, re.MULTILINE))
    assert sections <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_citation_has_what_the_format_asks_for_of_the_package_and_of_the_paper() -> None:
    for cited in (CITATION, CITATION["preferred-citation"]):
        assert {"title", "authors", "type"} <= cited.keys()
        assert all(
            {"name"} <= author.keys() or {"family-names", "given-names"} <= author.keys()
            for author in cited["authors"]
        )
    assert {"cff-version", "message"} <= CITATION.keys()
    assert CITATION["preferred-citation"]["doi"] in (ROOT / "README.md").read_text()


def test_installed_command_that_fails_or_leaves_nothing_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Commands in place of the installed one: ``false`` fails, ``true`` leaves no film."""
    for name, complaint in (
        ("false", r"false --version ended with 1"),
        ("true", r"true play did not leave play\.gif"),
    ):
        monkeypatch.setattr(sys, "argv", ["check_installed.py", str(shutil.which(name))])
        script = runpy.run_path(str(ROOT / "scripts" / "check_installed.py"))
        with pytest.raises(SystemExit, match=complaint):
            script["main"]()


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Check:
    """The check of the archives in a folder, where git holds ``TRACKED``."""
    script = runpy.run_path(str(ROOT / "scripts" / "check_dist.py"))
    main = script["main"]
    monkeypatch.setitem(main.__globals__, "tracked_files", lambda: TRACKED)
    monkeypatch.setattr(sys, "argv", ["check_dist.py", str(tmp_path)])
    return main


def write_archives(folder: Path, source: Iterable[str], wheel: Iterable[str]) -> None:
    with tarfile.open(folder / "torch_pmil-1.tar.gz", "w:gz") as archive:
        for name in (*source, "PKG-INFO", "torch_pmil.egg-info/PKG-INFO"):
            archive.addfile(tarfile.TarInfo(f"torch_pmil-1/{name}"), io.BytesIO())
    with zipfile.ZipFile(folder / "torch_pmil-1.whl", "w") as archive:
        for name in (*wheel, "torch_pmil-1.dist-info/METADATA"):
            archive.writestr(name, "")


LICENSE = "torch_pmil-1.dist-info/licenses/LICENSE"


def test_archives_that_hold_what_git_holds_pass(
    check: Check, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_archives(tmp_path, TRACKED, {*PACKAGE, LICENSE})
    check()
    assert [
        re.search(r": (\d+) files", line)[1] for line in capsys.readouterr().out.splitlines()
    ] == ["4", "2"]


@pytest.mark.parametrize(
    ("source", "wheel", "complaint"),
    [
        (TRACKED - {"tests/test_a.py"}, {*PACKAGE, LICENSE}, "tar.gz lacks tests/test_a.py"),
        (
            TRACKED | {"results/quick/a.json"},
            {*PACKAGE, LICENSE},
            "tar.gz holds what git does not: results/quick/a.json",
        ),
        (TRACKED, {"torch_pmil/__init__.py", LICENSE}, "whl lacks torch_pmil/py.typed"),
        (
            TRACKED,
            {*PACKAGE, LICENSE, "tests/test_a.py"},
            "whl holds what git does not: tests/test_a.py",
        ),
        (TRACKED, PACKAGE, "whl lacks the LICENSE"),
    ],
)
def test_archives_that_hold_something_else_are_refused(
    check: Check, tmp_path: Path, source: set[str], wheel: set[str], complaint: str
) -> None:
    write_archives(tmp_path, source, wheel)
    with pytest.raises(SystemExit, match=re.escape(complaint)):
        check()


def test_missing_archive_is_named(check: Check, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"expected one \*\.tar\.gz in .*, got 0"):
        check()


def test_link_to_a_folder_counts_as_its_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks" / "01.ipynb").write_text("{}")
    (tmp_path / "docs" / "notebooks").symlink_to("../notebooks")
    tracked_files = runpy.run_path(str(ROOT / "scripts" / "check_dist.py"))["tracked_files"]
    monkeypatch.setitem(tracked_files.__globals__, "ROOT", tmp_path)
    for command in (("init", "-q"), ("add", "-A")):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    assert tracked_files() == {"notebooks/01.ipynb", "docs/notebooks/01.ipynb"}
