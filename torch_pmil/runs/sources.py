"""A hash of the sources that made a result; docstrings and comment lines do not change it.

Commands, figures and reports, which show what was learned, do not count either. Nor does how a run
chooses the sampling of a robot of one's own: its folder holds the choice, and no shipped task asks.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
LEFT_OUT = tuple(map(Path, ("cli", "plotting", "runs/report", "tasks/sampling_choice.py")))
# statements that are a string alone, lines of comments and empty lines; other strings are code
TEXT = r'"""(?:(?!""")[\s\S])*"""'
NO_CODE = re.compile(rf"^[ \t]*(?:r?{TEXT}[ \t]*(?:#.*)?|#.*)?\n|(?P<code>{TEXT})", re.MULTILINE)


@cache
def hash_of_sources(package: Path = PACKAGE) -> str:
    """Twelve hexadecimal digits of the code of the modules in a folder."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package)
        if any(map(name.is_relative_to, LEFT_OUT)):
            continue
        digest.update(name.as_posix().encode())
        digest.update(code_of(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:12]


def code_of(source: str) -> str:
    r"""A module's text without docstrings, lines of comments and empty lines.

    Example:
        >>> code_of("# what it is\n\nx = 1\n")
        'x = 1\n'
    """
    return NO_CODE.sub(lambda found: found["code"] or "", source)
