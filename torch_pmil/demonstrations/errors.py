"""The one-line error for malformed demonstrations, and bounds on what is read of a file."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from torch_pmil.files import MIB, FileError, LineError, opened, short

# raised by parsers at damaged bytes; UnicodeDecodeError is a ValueError, NotImplementedError a
# RuntimeError
DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    OverflowError,
    RuntimeError,
    MemoryError,
    EOFError,
)

FILE_BYTES = 256 * MIB  # of a file that is read as a whole
TEXT_BYTES = 64 * MIB  # of a CSV file, whose cells take ten times that, or a MATLAB file
SET_BYTES = 2**40  # of a data set of which columns are read, beside its pictures
NAME = 200  # characters of the name of an entry
# the argument of the functions, and the option of the commands
TIME_STEP = "time_step (--recorded-time-step of pmil inspect and pmil align)"
HEAD = 64  # bytes by which a file shows what it is
SIGNS = {  # with which files begin, whatever their suffix
    b"version https://git-lfs": "a Git LFS pointer: git lfs pull fetches the file it stands for",
    b"<!doctype html": "a web page",
    b"<html": "a web page",
    b"\x1f\x8b": "a gzip archive",
    b"PK\3\4": "a ZIP archive",
    b"\x89HDF": "an HDF5 file",
    b"PAR1": "a Parquet file",
    b"MATLAB 5": "a MATLAB file",
    b"\x93NUMPY": "a single array of NumPy",
    b"\xff\xfe": "text in UTF-16, not UTF-8",
    b"\xfe\xff": "text in UTF-16, not UTF-8",
}
MOST = {
    "demonstrations": 10_000,
    "entries": 10_000,  # of a sample
    "numbers": 2**24,  # that are read
    "cells": 2**21,  # of CSV; each takes a hundred bytes, even in an empty row
    "data sets": 2000,  # of HDF5, side by side in a demonstration
    "chunks": 2**17,  # of HDF5; each takes some microseconds and 2 kB, even if empty
    "elements": 1000,  # of a MATLAB file; those of LASA have a handful
    "arrays": 20_000,  # within each other in a MATLAB file; those of LASA have some fifty
    "unpacked bytes": TEXT_BYTES,  # of a MATLAB file
}


class DemonstrationError(LineError):
    """Demonstrations are malformed: one line says where, what was expected and what came."""


class UnknownEntryError(DemonstrationError):
    """A file lacks an entry that is to be read."""


@contextmanager
def readable(kind: str, *failures: type[Exception]) -> Iterator[None]:
    """Turn a library's exception at a damaged file into a DemonstrationError.

    The message is "not a readable ``kind``"; ``failures`` are exceptions of this library alone.

    Example:
        >>> try:
        ...     with readable("number"):
        ...         float("five")
        ... except DemonstrationError as error:
        ...     print(error)
        not a readable number (could not convert string to float: 'five')
    """
    damage: tuple[type[Exception], ...] = (*DAMAGE, *failures)
    try:
        yield
    except DemonstrationError:
        raise
    except damage as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DemonstrationError(f"not a readable {kind} ({reason})") from error


def check_count(things: str, count: int) -> None:
    """Raise DemonstrationError if a file has more things than ``MOST``."""
    if count > MOST[things]:
        raise DemonstrationError(f"there must be at most {MOST[things]} {things}, got {count}")


def check_names(names: Sequence[str], count: int, name: str = "names", of: str = "column") -> None:
    """Raise DemonstrationError unless there are as many names as columns, all different.

    Each is a line of at most ``NAME`` characters that is not empty.
    """
    if count < 1 or len(names) != count:
        raise DemonstrationError(
            f"{name} must be {count} different names, one per {of}, got {short(tuple(names))}"
        )
    for held in map(str, names):
        if not (held.strip() and held.isprintable() and len(held) <= NAME):
            raise DemonstrationError(
                f"{name} must have 1 to {NAME} printable characters, got {short(held)}"
            )
    for held, times in Counter(names).items():
        if times > 1:
            raise DemonstrationError(
                f"{name} must be different, one per {of}, got {held!r} {times} times"
            )


def check_kind(kind: str, head: bytes, sign: bytes = b"") -> None:
    """Raise DemonstrationError if a file is empty, or begins like a file of another kind.

    Args:
        kind: the kind that it must be.
        head: its first bytes.
        sign: the one of ``SIGNS`` with which files of this kind begin, if any.

    Example:
        >>> check_kind("a Parquet file", b"PAR1", b"PAR1")
        >>> try:
        ...     check_kind("a CSV file", b"PAR1")
        ... except DemonstrationError as error:
        ...     print(error)
        must be a CSV file, got a Parquet file
    """
    text = head[:HEAD].lstrip(b"\xef\xbb\xbf \t\r\n")
    begun = [begin for begin in SIGNS if text.startswith(begin) or text.lower().startswith(begin)]
    if not text or (begun and begun != [sign]):
        found = SIGNS[begun[0]] if begun else "an empty file"
        raise DemonstrationError(f"must be {kind}, got {found}")


@contextmanager
def opened_set(path: Path, kind: str, sign: bytes) -> Iterator[BinaryIO]:
    """A data set's file, open for reading, unless it is of another kind (see check_kind)."""
    with opened(path, SET_BYTES) as file:
        check_kind(kind, file.read(HEAD), sign)
        file.seek(0)
        yield file


@contextmanager
def within(where: object) -> Iterator[None]:
    """Add the name of the file to a DemonstrationError, or turn a FileError into one.

    Example:
        >>> try:
        ...     with within("walks.csv"):
        ...         raise DemonstrationError("row 3 must have 4 columns, got 3")
        ... except DemonstrationError as error:
        ...     print(error)
        walks.csv: row 3 must have 4 columns, got 3
    """
    try:
        yield
    except (DemonstrationError, FileError) as error:
        kind = type(error) if isinstance(error, DemonstrationError) else DemonstrationError
        raise kind(f"{where}: {error}") from error.__cause__


def optional(module: str) -> ModuleType:
    """Import an optional library. The ImportError says how to install it.

    Example:
        >>> optional("json").loads("[1]")
        [1]
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f"reading this format needs {module.partition('.')[0]}: pip install "
            "'torch_pmil[formats]'"
        ) from error
