"""The page on the method and the code point to each other, equation by equation."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

import torch_pmil

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "start" / "method.md").read_text()
SHOWN = [int(number) for number in re.findall(r"\\tag\{(\d+)\}", PAGE)]
LINK = r"\{code\}`([\w.]+)`"
LINKED = re.findall(LINK, PAGE)
SAID = re.findall(
    r"((?:\{code\}`[\w.]+`(?: and )?)+) \((?:the moments of )?(Eqs?\. [\d, and-]*\d)", PAGE
)
TOLD = [(path, equations) for paths, equations in SAID for path in re.findall(LINK, paths)]


def numbers(text: str) -> set[int]:
    """Equations of the paper that a text cites, not those cited after the names of others."""
    text = re.sub(r"(Rasmussen|Williams)[^.]*, Eqs?\. [\d.]+( and \d+)?", "", text)
    found: set[int] = set()
    for cited in re.findall(r"\bEqs?\. (\d+(?:(?:-|, | and | or )\d+)*)", text):
        for first, last in re.findall(r"(\d+)(?:-(\d+))?", cited):
            found |= set(range(int(first), int(last or first) + 1))
    return found


def docstrings() -> Iterator[str]:
    """Of all modules, classes and functions of the package."""
    package = Path(torch_pmil.__file__).parent
    for path in (*package.rglob("*.py"), *(ROOT / "reproduction").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                yield ast.get_docstring(node) or ""


def test_numbers_are_read_as_people_read_them() -> None:
    assert numbers(
        "Eqs. 14-16, 19 and 22; Eq. 5, in four. Deisenroth and Rasmussen (2011), Eqs. 24 and 25."
    ) == {5, 14, 15, 16, 19, 22}
    assert numbers("nothing (Rasmussen and Williams 2006, Eq. 2.30)") == set()


def test_every_equation_that_a_docstring_cites_is_on_the_page_and_the_other_way_round() -> None:
    cited = set().union(*map(numbers, docstrings()))
    assert sorted(cited) == sorted(SHOWN) == [*range(1, 32)]  # each shown once


def test_linked_code_cites_the_equations_that_the_page_says_it_computes() -> None:
    assert all(map(pkgutil.resolve_name, LINKED)) and len(TOLD) > 20
    for path, equations in TOLD:
        code = pkgutil.resolve_name(path)
        cited = numbers(f"{inspect.getdoc(code)} {inspect.getdoc(inspect.getmodule(code))}")
        assert numbers(equations) <= cited, path
