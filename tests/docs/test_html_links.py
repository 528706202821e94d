"""The check of the built pages' links."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.extensions import extension

html_links = extension("html_links")


@pytest.mark.parametrize(
    "link",
    [
        "other.html",
        "other.html#here",
        "#there",
        "other.html?x=1#here",
        "a%20picture.png",
        "https://elsewhere.org/no",
        "mailto:us",
    ],
)
def test_whole_link_is_passed(link: str, tmp_path: Path) -> None:
    write(tmp_path, link)
    assert list(html_links.broken_links(tmp_path)) == []


@pytest.mark.parametrize(
    "link",
    [
        "none.html",
        "other.html#there",
        "#here",
        "none.png",
        "folder/",
        "../outside.html",
        "/other.html",
    ],
)
def test_broken_link_is_found_with_its_page(link: str, tmp_path: Path) -> None:
    write(tmp_path, link)
    assert list(html_links.broken_links(tmp_path)) == [("index.html", link)]


def write(folder: Path, link: str) -> None:
    (folder / "index.html").write_text(f'<p id="there"><a href="{link}">a link</a></p>')
    (folder / "other.html").write_text('<h1 id="here">Here</h1>')
    (folder / "folder").mkdir()
    (folder / "folder" / "index.html").write_text("")
    (folder / "a picture.png").write_bytes(b"")
