"""One run at a time in a folder."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system: no locks
    fcntl = None  # type: ignore[assignment]

_held: dict[Path, int] = {}  # folders of this process's runs, and the threads of these


class RunGoingOnError(ValueError):
    """Another run is going on in a folder; the message names its process."""


@contextmanager
def alone_in(folder: Path | str) -> Iterator[None]:
    """Keep other runs out of a folder, which is made if it is missing.

    The file ``.pmil.lock`` in it is locked meanwhile. The lock ends with the process in any case,
    so a file that is left behind locks nothing. The thread that holds the lock may enter again. A
    file system without locks allows several runs.

    Raises:
        RunGoingOnError: another run is there.
        OSError: the folder cannot be made or written to.

    Example:
        >>> import tempfile
        >>> folder = tempfile.mkdtemp()
        >>> with alone_in(folder):
        ...     os.listdir(folder)
        ['.pmil.lock']
        >>> os.listdir(folder)
        []
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    place, path = folder.resolve(), folder / ".pmil.lock"
    if _held.get(place) == threading.get_ident():
        yield
        return
    file = _locked(path)
    _held[place] = threading.get_ident()
    try:
        yield
    finally:
        del _held[place]
        with suppress(OSError):  # the folder may have been removed or renamed
            if _is_that(path, file):
                path.unlink()
        os.close(file)


def _locked(path: Path) -> int:
    """The open and locked file of that name, which holds the number of this process."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            _lock(file, path)
            if not os.pread(file, 21, 0).isdigit() and os.fstat(file).st_size:
                raise FileExistsError(errno.EEXIST, "is not the lock of a run", str(path))
            if _is_that(path, file):  # its owner may just have removed it
                os.ftruncate(file, 0)
                os.write(file, str(os.getpid()).encode())
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _lock(file: int, path: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        owner = os.read(file, 20).decode(errors="replace") or "unknown"
        raise RunGoingOnError(
            f"a run is going on in {path.parent} (process {owner}): wait for its end, or choose "
            "another out"
        ) from None
    except OSError:  # a file system without locks
        return


def _is_that(path: Path, file: int) -> bool:
    """Whether a path leads to an open file."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(file))
    except FileNotFoundError:
        return False
