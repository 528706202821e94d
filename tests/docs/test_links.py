"""Links between the pages, as a code host shows them, lead to files and to headings."""

from __future__ import annotations

import re
from pathlib import Path

import torch_pmil

ROOT = Path(__file__).parents[2]
PACKAGE = Path(torch_pmil.__file__).parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
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
    broken = [(page.name, link) for page, link in LINKS if not leads_somewhere(page, link)]
    assert broken == []


def test_every_page_is_in_a_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text().splitlines()
    pages = [page.relative_to(ROOT / "docs").with_suffix("").as_posix() for page in PAGES[1:]]
    assert [page for page in pages if page != "index" and page not in index] == []
