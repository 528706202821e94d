"""Links between the pages, as a code host shows them: each leads to a file, and to a heading of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import torch_pmil

ROOT = Path(__file__).parents[2]
PACKAGE = Path(torch_pmil.__file__).parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!\w+:)([^)\s]+)\)")  # but https: and the like
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links."""
    headings = HEADING.findall(
        re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    )
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


LINKS = [(page, link) for page in PAGES for link in LINK.findall(CODE.sub("", page.read_text()))]


def test_there_are_links() -> None:
    assert len(LINKS) > 50


@pytest.mark.parametrize(
    ("page", "link"), LINKS, ids=lambda value: value.name if isinstance(value, Path) else value
)
def test_link_leads_to_a_file_and_to_a_heading_of_it(page: Path, link: str) -> None:
    path, _, anchor = link.partition("#")
    target = (page.parent / path).resolve() if path else page
    assert target.is_relative_to(ROOT)
    if target.is_relative_to(ROOT / "torch_pmil"):
        target = PACKAGE / target.relative_to(ROOT / "torch_pmil")  # wherever it is installed
    assert target.exists()
    assert not anchor or anchor in anchors(target)


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.name)
def test_every_page_is_in_a_table_of_contents(page: Path) -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    assert page.stem == "index" or re.search(rf"^{page.stem}$", index, re.MULTILINE)
