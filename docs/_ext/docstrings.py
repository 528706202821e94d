"""What lets docstrings read well as plain text and as pages: shapes without escapes, references
without module names.

And signatures of classes whose metaclass hides them.
"""

from __future__ import annotations

import inspect
import re

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.inspect import signature as signature_of, stringify_signature

STAR = re.compile(
    r"(?<![\\\w*])\*(?=[A-Za-z]+\b[,)])"
)  # shapes as (*batch, D); a star would begin emphasis


ARGUMENTS = re.compile(r"\[[^\[\]]*,[^\[\]]*\]")


def escape_shapes(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Escape the star of a shape, but in code.

    Of a property's docstring napoleon takes what stands before a colon for a type: an empty comment
    goes first.
    """
    if what in ("property", "attribute"):
        lines[:0] = ["..", ""]
    lines[:] = [
        line if line.lstrip().startswith((">>>", "...")) else STAR.sub(r"\\*", line)
        for line in lines
    ]


def own_signature(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: object,
    signature: str | None,
    returns: str | None,
) -> tuple[str, str | None] | None:
    """The signature of ``__init__`` in place of that of the metaclass of TorchRL's environments,
    losses and modules.

    Sphinx splits one with ``<factory>`` at each comma, so types lose arguments that have commas.
    """
    if signature is not None and "<factory>" in signature:
        return ARGUMENTS.sub("", signature), returns
    if what != "class" or signature != "(*args, **kwargs)" or not inspect.isfunction(obj.__init__):
        return None
    return stringify_signature(
        signature_of(obj.__init__, bound_method=True), show_return_annotation=False
    ), None


def find_by_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.Element | None:
    """Resolve a reference to an object of another module by its name alone, where there is one of
    that name.
    """
    if node.get("refdomain") != "py" or node.get("refspecific"):
        return None
    node["refspecific"] = True
    return env.domains.python_domain.resolve_xref(
        env, node["refdoc"], app.builder, node["reftype"], node["reftarget"], node, content
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", escape_shapes, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", own_signature)
    app.connect("missing-reference", find_by_name)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
