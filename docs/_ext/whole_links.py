"""After the build: every link inside the pages leads to a page and an anchor that are there."""

from __future__ import annotations

from html_links import broken_links
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)


def check(app: Sphinx, exception: Exception | None) -> None:
    """Warn of each broken link."""
    if exception is None and app.builder.format == "html":
        for page, link in broken_links(app.outdir):
            logger.warning("broken link in %s: %s", page, link)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
