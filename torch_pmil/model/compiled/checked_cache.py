"""Numba's cache on disk, restricted to files that this user wrote and nobody has changed.

A file holds machine code, and a pickle that executes what it names. So each begins with the SHA-256
checksum of the rest, and must belong to this user and be writable by nobody else. Any other file is
discarded and compiled again.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import stat
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

config: Any = numba.config
CHECKSUM = 32  # bytes
FOR_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def is_private(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user and nobody else may write to it."""
    if not hasattr(os, "geteuid"):  # not a POSIX system
        return True
    return status.st_uid == os.geteuid() and not status.st_mode & FOR_OTHERS


def is_private_folder(folder: Path) -> bool:
    """Whether a folder is private, and those who may write beside it may not rename it."""
    status, above = folder.lstat(), folder.parent.stat().st_mode
    others = above & stat.S_IWOTH and not above & stat.S_ISVTX
    return stat.S_ISDIR(status.st_mode) and is_private(status) and not others


@functools.cache
def complain(message: str) -> None:
    """Warn of this once in a process."""
    warnings.warn(message, RuntimeWarning, stacklevel=2)


class _CheckedFiles(caching.IndexDataCacheFile):
    """The index of a kernel and its data, with checksums."""

    def _load_index(self) -> dict[Any, str]:
        with suppress(OSError):
            version, stamp, overloads = pickle.loads(self._read(self._index_path))
            if (version, stamp) == (self._version, self._source_stamp):
                return overloads
        return {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._write(self._index_path, self._dump((self._version, self._source_stamp, overloads)))

    def _load_data(self, name: str) -> Any:
        return pickle.loads(self._read(self._data_path(name)))

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), self._dump(data))

    def _read(self, path: str) -> bytes:
        """What :meth:`_write` wrote. Any other file is deleted, and OSError is raised."""
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
            status = os.fstat(file.fileno())
            content = file.read() if stat.S_ISREG(status.st_mode) and is_private(status) else b""
        if content and hashlib.sha256(content[CHECKSUM:]).digest() == content[:CHECKSUM]:
            return content[CHECKSUM:]
        complain(
            f"the compiled prediction in {Path(path).parent} is damaged or not of this user: it is "
            "compiled again"
        )
        with suppress(OSError):
            os.unlink(path)
        raise OSError("damaged")

    def _write(self, path: str, content: bytes) -> None:
        with self._open_for_write(path) as file:
            if hasattr(os, "fchmod"):
                os.fchmod(file.fileno(), stat.S_IRUSR | stat.S_IWUSR)
            file.write(hashlib.sha256(content).digest() + content)


class _InOneFolder(caching.CompileResultCacheImpl):
    """Looks for files in no folder but the one that was checked."""

    _locator_classes = [caching.UserProvidedCacheLocator]


class CheckedCache(caching.FunctionCache):
    """The cache of a kernel; what cannot be written is not kept, with one warning.

    Raises RuntimeError if the folder cannot be written to.
    """

    _impl_class = _InOneFolder
    lost = False  # whether anything could not be kept

    @classmethod
    def lose(cls, reason: str | None) -> None:
        """Warn that something is not kept."""
        cls.lost = True
        complain(
            f"the compiled prediction cannot be kept in {config.CACHE_DIR} ({reason}), so "
            "every process compiles it anew; NUMBA_CACHE_DIR names another folder"
        )

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        files = self._cache_file
        names = self._impl.filename_base, files._source_stamp
        self._cache_file = _CheckedFiles(self._cache_path, *names)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep what was compiled, if there is room."""
        try:
            super().save_overload(signature, data)
        except OSError as error:
            CheckedCache.lose(error.strerror)
