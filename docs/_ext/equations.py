"""Equations of the paper by their numbers: those of the page on the method are targets, and
docstrings that cite one link to it.
"""

from __future__ import annotations

import re

from docutils import nodes
from sphinx.application import Sphinx

TAG = re.compile(r"\\tag\{(\d+)\}")
CITED = re.compile(r"\bEqs?\. \d+(?:(?:-|, | and | or )\d+)*(?![.\d])")
OF_ANOTHER = re.compile(
    r"(Rasmussen|Williams|Deisenroth)[^.]*,\s*$"
)  # "Deisenroth and Rasmussen (2011), Eqs. 24 and 25"
NO_TEXT = re.compile(
    r"^\s*(>>>|\.\.\.)|\S {2,}\S"
)  # code, or a row of a table, whose columns have their widths
PAGE = "start/method"


def name_targets(app: Sphinx, doctree: nodes.document) -> None:
    """Give each displayed equation with ``\\tag{19}`` the label ``eq-19``."""
    docname, standard = app.env.current_document.docname, app.env.domains.standard_domain
    if docname != PAGE:
        return
    for node in doctree.findall(nodes.math_block):
        for number in TAG.findall(node.astext()):
            node["ids"].append(f"eq-{number}")
            standard.anonlabels[f"eq-{number}"] = docname, f"eq-{number}"


def link_citations(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Make links of "Eq. 19" and of the numbers in "Eqs. 14-18" or "Eqs. 6 and 7"."""
    lines[:] = [line if NO_TEXT.search(line) else CITED.sub(_link, line) for line in lines]


def _link(cited: re.Match[str]) -> str:
    if OF_ANOTHER.search(cited.string[: cited.start()]):
        return cited.group()
    word, _, numbers = cited.group().partition(" ")
    if numbers.isdecimal():
        return f":ref:`Eq. {numbers} <eq-{numbers}>`"
    return f"{word} " + re.sub(r"\d+", r":ref:`\g<0> <eq-\g<0>>`", numbers).replace(
        "`-:", "`\\ -\\ :"
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("doctree-read", name_targets)
    app.connect("autodoc-process-docstring", link_citations)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
