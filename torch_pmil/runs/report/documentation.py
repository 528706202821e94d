"""Pages of the documentation that a report names."""

from __future__ import annotations

from pathlib import Path

import torch_pmil

FOLDER = "docs/how_to"  # of the repository
BUILT = "docs/_build/html/how_to"


def page_of(name: str) -> tuple[str, str | None]:
    """Path of a page in the repository, and the address of the page on this machine.

    The address is that of the built page, or of its source; None where there is neither, as beside
    a wheel.

    Args:
        name: of the page, as ``"diagnosis"``.

    Example:
        >>> page_of("diagnosis")[0]
        'docs/how_to/diagnosis.md'
    """
    clone, path = Path(torch_pmil.__file__).parents[1], f"{FOLDER}/{name}.md"
    places = (clone / BUILT / f"{name}.html", clone / path)
    return path, next((place.as_uri() for place in places if place.exists()), None)
