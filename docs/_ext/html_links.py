"""Links between the pages of a folder of HTML files."""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LINKS = {
    "a": "href",
    "link": "href",
    "img": "src",
    "script": "src",
    "source": "src",
    "video": "src",
}


class _Page(HTMLParser):
    """What a page links to, and its anchors."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors = {"", "top"}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value for name, value in attrs if value is not None}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if LINKS.get(tag) in values:
            self.links.append(values[LINKS[tag]])


def broken_links(folder: Path) -> Iterator[tuple[str, str]]:
    """Page and link, for each link inside a folder whose file or anchor is not there."""
    folder = folder.resolve()
    pages = {path: _Page(path.read_text()) for path in folder.rglob("*.html")}
    for path, page in sorted(pages.items()):
        for link in dict.fromkeys(page.links):
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            there = (
                target in pages and unquote(url.fragment) in pages[target].anchors
                if target.suffix == ".html"
                else target.is_file()
            )
            if not there:
                yield str(path.relative_to(folder)), link
