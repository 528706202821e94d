"""The check of the built pages' links."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.extensions import extension

html_links = extension("html_links")


WHOLE = ["other.html", "other.html#here", "#there", "other.html?x=1#here", "a%20picture.png"]
ELSEWHERE = ["https://elsewhere.org/no", "mailto:us"]
BROKEN = ["no.html", "other.html#there", "#here", "no.png", "folder/", "../no.html", "/other.html"]


@pytest.mark.parametrize("link", [*WHOLE, *ELSEWHERE, *BROKEN])
def test_broken_links_are_found_with_their_page_and_whole_ones_are_passed(
    link: str, tmp_path: Path
) -> None:
    (tmp_path / "index.html").write_text(f'<p id="there"><a href="{link}">a link</a></p>')
    (tmp_path / "other.html").write_text('<h1 id="here">Here</h1>')
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "index.html").write_text("")
    (tmp_path / "a picture.png").write_bytes(b"")
    found = [("index.html", link)] if link in BROKEN else []
    assert list(html_links.broken_links(tmp_path)) == found
