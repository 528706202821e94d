"""Files that are either whole or not there."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """A temporary name beside ``path`` to write to, which replaces it when the block ends well.

    It is removed when the block ends with an error. The temporary file is new and empty: what was
    there under its name, a link too, is removed and never written to.

    Args:
        path: the file to make or to replace. The temporary name keeps its suffix.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "numbers.csv"
        >>> with replacing(path) as temporary:
        ...     _ = temporary.write_text("1,2")
        >>> path.read_text()
        '1,2'
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    _make_new(temporary)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _make_new(path: Path) -> None:
    """Make an empty file where there may be debris of a process that had our number."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
    try:
        file = os.open(path, flags, 0o666)
    except FileExistsError:
        path.unlink()
        file = os.open(path, flags, 0o666)
    os.close(file)


def remove_temporaries(path: Path | str) -> None:
    """Remove what :func:`replacing` left beside ``path`` where its process was killed.

    A path ``*.png`` stands for all files of that suffix in its folder.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> (folder / ".video.4711.mp4").touch()
        >>> remove_temporaries(folder / "video.mp4")
        >>> list(folder.iterdir())
        []
    """
    path = Path(path)
    stem = ".+" if path.stem == "*" else re.escape(path.stem)
    name = re.compile(rf"\.{stem}\.\d+{re.escape(path.suffix)}")
    for left in path.parent.iterdir() if path.parent.is_dir() else ():
        if name.fullmatch(left.name) and not left.is_dir():
            left.unlink(missing_ok=True)


def write_json(path: Path | str, content: object) -> None:
    """Write a JSON file, whole or not at all.

    Raises ValueError at a number that is not finite: JSON has none.
    """
    text = json.dumps(content, indent=2, allow_nan=False)
    with replacing(path) as temporary:
        temporary.write_text(text + "\n")
