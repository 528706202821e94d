"""The API reference holds every module of the package, once."""

from __future__ import annotations

import re
from pathlib import Path

import torch_pmil

ROOT = Path(__file__).parents[2]


def test_every_module_is_in_the_api_reference_once() -> None:
    roots = Path(torch_pmil.__file__).parent, ROOT / "reproduction"
    files = [
        path.relative_to(root.parent)
        for root in roots
        for path in root.rglob("*.py")
        if path.name != "__main__.py"
    ]
    modules = {".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in files}
    pages = (ROOT / "docs" / "api").glob("*.rst")
    listed = [n for page in pages for n in re.findall(r"automodule:: (\S+)", page.read_text())]
    assert sorted(listed) == sorted(modules - {"torch_pmil"})
