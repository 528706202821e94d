"""The directive ``results``, a table of numbers, and the role ``result``, a text with numbers.

Both take the name of a summary and templates, as :mod:`summaries` describes them. A number that the
summary does not have is an error, with which the build fails. A page ends with the results that it
quotes and earlier sources made.
"""

from __future__ import annotations

from docutils import nodes
from docutils.parsers.rst.directives import unchanged
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole
from summaries import fill, is_older, note_of_older, path_of, provenance, sources, table


class ResultsDirective(SphinxDirective):
    """A table, and below the first one of a page that has them, where its numbers come from."""

    required_arguments = 1
    has_content = True
    option_spec = {"rows": unchanged, "columns": unchanged}

    def run(self) -> list[nodes.Node]:
        source = self.arguments[0]
        names = sources(source, **self.options)
        for name in names:
            self.env.note_dependency(str(path_of(name)))
        try:
            header, *rows = table(source, list(self.content), **self.options)
        except (KeyError, ValueError, OSError) as error:
            raise self.error(str(error)) from error
        lines = [header, ["---"] * len(header), *rows]
        text = [f"| {' | '.join(cells)} |" for cells in lines]
        text += [line for name in self._to_name(names) for line in ("", provenance(name))]
        node = nodes.container(classes=["results"])
        self.state.nested_parse(StringList(text, source), self.content_offset, node)
        return [node]

    def _to_name(self, names: list[str]) -> list[str]:
        """Summaries that no table before on this page has named, and all of earlier sources."""
        named = self.env.current_document.setdefault("results_named", set())
        found = [name for name in names if name not in named or is_older(name)]
        named.update(names)
        return found


class ResultRole(SphinxRole):
    """``{result}`paper/box {rollouts_with} rollouts```."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        name, _, template = self.text.partition(" ")
        try:
            return [nodes.Text(fill(name, template))], []
        except (KeyError, OSError) as error:
            message = self.inliner.reporter.error(f"{self.text}: {error}", line=self.lineno)
            return [], [message]


def add_note_of_older(app: Sphinx, page: str, source: list[str]) -> None:
    """Called by Sphinx with the text of each page."""
    if app.env.doc2path(page).suffix == ".md" and (note := note_of_older(source[0])):
        source[0] += f"\n\n---\n\n{note}\n"


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", add_note_of_older)
    app.add_directive("results", ResultsDirective)
    app.add_role("result", ResultRole())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
