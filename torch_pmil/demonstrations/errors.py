"""The one-line error for malformed demonstrations, and bounds on what is read of a file."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType

from torch_pmil.files import MIB, FileError, LineError

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
    """Raise DemonstrationError unless there are as many names as columns, all different."""
    if count < 1 or len(names) != count or len(set(names)) != count:
        raise DemonstrationError(
            f"{name} must be {count} different names, one per {of}, got {tuple(names)}"
        )


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
        raise DemonstrationError(f"{where}: {error}") from error.__cause__


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
