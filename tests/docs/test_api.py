"""The API reference holds every module of the package, once."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_module_is_in_the_api_reference_once() -> None:
    files = [path.relative_to(ROOT) for path in (ROOT / "torch_pmil").rglob("*.py") if path.name != "__main__.py"]
    modules = {".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in files} - {"torch_pmil"}
    listed = [name for page in (ROOT / "docs" / "api").glob("*.rst") for name in re.findall(r"automodule:: (\S+)", page.read_text())]
    assert sorted(listed) == sorted(modules)
