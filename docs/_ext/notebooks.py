"""Links between notebooks: they are pages by way of the link ``docs/notebooks``, which MyST follows
to where they are.
"""

from __future__ import annotations

from pathlib import Path

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx


def name_as_pages(app: Sphinx, doctree: nodes.document) -> None:
    """Call linked notebooks by their names below the documentation."""
    folder = Path(app.srcdir, "notebooks").resolve()
    for node in doctree.findall(pending_xref):
        target = Path(node["reftarget"])
        if node.get("refdomain") == "doc" and target.is_relative_to(folder):
            node["reftarget"] = f"notebooks/{target.relative_to(folder)}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("doctree-read", name_as_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
