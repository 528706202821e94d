"""Links between the pages, as a code host shows them, lead to files, headings and tests."""

from __future__ import annotations

import re
from pathlib import Path

import torch_pmil
from tests.helpers.pages import FENCE, PAGES, ROOT

PACKAGE = Path(torch_pmil.__file__).parent
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!\w+:)([^)\s]+)\)")  # but https: and the like
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links."""
    headings = HEADING.findall(FENCE.sub("", page.read_text()))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


LINKS = [
    (page, link)
    for page in (ROOT / "README.md", *PAGES)
    for link in LINK.findall(CODE.sub("", page.read_text()))
]


def leads_somewhere(page: Path, link: str) -> bool:
    """Whether a link leads to a file of the repository, and to a heading of it if it names one."""
    path, _, anchor = link.partition("#")
    target = (page.parent / path).resolve() if path else page
    if not target.is_relative_to(ROOT):
        return False
    if target.is_relative_to(ROOT / "torch_pmil"):  # wherever it is installed
        target = PACKAGE / target.relative_to(ROOT / "torch_pmil")
    return target.exists() and (not anchor or anchor in anchors(target))


def test_links_lead_to_files_and_to_headings_of_them() -> None:
    assert len(LINKS) > 50
    assert [found for found in LINKS if not leads_somewhere(*found)] == []


def test_every_page_is_in_a_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text().splitlines()
    pages = [page.relative_to(ROOT / "docs").with_suffix("").as_posix() for page in PAGES]
    assert [page for page in pages if page != "index" and page not in index] == []


def test_every_promise_names_tests_that_are_there() -> None:
    text = (ROOT / "docs" / "guarantees.md").read_text()
    rows = re.findall(r"^\| .*", text.partition("## Quiet motions")[0], re.MULTILINE)
    promises = [row for row in rows if not row.startswith(("| promise", "| ---"))]
    assert len(promises) > 15 and [row for row in promises if "`tests/" not in row] == []
    for path, name in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", text):
        assert f"\ndef {name}(" in (ROOT / path).read_text(), name
