"""The role ``{code}`torch_pmil.search.kl.gaussian_kl```: a link to the line at which the source of
this object begins.

The page it leads to is one of ``sphinx.ext.viewcode``, a part of the documentation. An object that
is not there, or that the API reference does not hold, is a warning, with which the build fails.
"""

from __future__ import annotations

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import PycodeError
from sphinx.pycode import ModuleAnalyzer
from sphinx.util import logging
from sphinx.util.docutils import SphinxRole

logger = logging.getLogger(__name__)


class CodeRole(SphinxRole):
    """Reads where the object is; :func:`resolve` makes the link when all pages have been read."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        module, name, line = locate(self.text)
        node = code_link(module=module, name=name, path=self.text)
        node += nodes.literal(
            text=f"{name} ({module.rpartition('.')[2]}.py:{line})" if line else self.text
        )
        node.source, node.line = self.get_source_info()
        return [node], []


class code_link(nodes.Inline, nodes.TextElement):
    """A link to source that is not resolved yet."""


def locate(path: str) -> tuple[str, str, int]:
    """Module, name inside it, and line of an object with a dotted path; line 0 if there is none."""
    parts = path.split(".")
    for length in range(len(parts) - 1, 0, -1):
        module, name = ".".join(parts[:length]), ".".join(parts[length:])
        try:
            tags = ModuleAnalyzer.for_module(module).find_tags()
        except PycodeError:
            continue
        return module, name, tags[name][1] if name in tags else 0
    return "", path, 0


def resolve(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Make links of the roles of a page."""
    documented = app.env.domains.python_domain.objects
    for node in list(doctree.findall(code_link)):
        if node["path"] not in documented:
            logger.warning("no such object in the API reference: %s", node["path"], location=node)
        page = f"_modules/{node['module'].replace('.', '/')}"
        target = f"{app.builder.get_relative_uri(docname, page)}#{node['name']}"
        node.replace_self(nodes.reference("", "", *node.children, refuri=target, internal=True))


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_role("code", CodeRole(), override=True)
    app.add_node(code_link)
    app.connect("doctree-resolved", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
