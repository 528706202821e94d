"""The pages of the API reference, written before each build: one for each room of the package."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from sphinx.application import Sphinx


def pages(root: Path) -> dict[str, str]:
    """The pages by their names, with a section for each module of the packages below ``root``."""
    sections = defaultdict(list)
    for package in ("torch_pmil", "reproduction"):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if parts == ("torch_pmil", "__init__") or parts[-1] == "__main__":
                continue  # the names of the former are those of the rooms
            room = parts[1] if package == "torch_pmil" and len(parts) > 2 else package
            module = ".".join(parts).removesuffix(".__init__")
            sections[room].append((module.removeprefix("torch_pmil."), module))
    return {
        room: heading(room, "=")
        + "".join(f"{heading(name, '-')}.. automodule:: {module}\n\n" for name, module in found)
        for room, found in sections.items()
    }


def heading(text: str, line: str) -> str:
    """A heading of reStructuredText."""
    return f"{text}\n{line * len(text)}\n\n"


def write_pages(app: Sphinx) -> None:
    """Write the pages that changed, and remove those of rooms that are gone."""
    if app.srcdir != app.confdir:  # pages of a test
        return
    folder = Path(app.srcdir, "api")
    folder.mkdir(exist_ok=True)
    wanted = {folder / f"{name}.rst": text for name, text in pages(folder.parents[1]).items()}
    for path in {*folder.glob("*.rst")} - {*wanted}:
        path.unlink()
    for path, text in wanted.items():
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
