"""The directive ``settings``: the table of all settings, as they are declared."""

from __future__ import annotations

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from torch_pmil.runs.settings import documentation_rows


class SettingsDirective(SphinxDirective):
    """A row for each setting: name, meaning, values, unit."""

    def run(self) -> list[nodes.Node]:
        header = ["| setting | meaning | values | unit |", "| --- | --- | --- | --- |"]
        node = nodes.container(classes=["results"])
        text = StringList([*header, *documentation_rows()], "settings")
        self.state.nested_parse(text, self.content_offset, node)
        return [node]


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("settings", SettingsDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
