"""The error for malformed demonstrations, which says in one line what is wrong with a file."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from torch_pmil.files import MIB, FileError, LineError, opened, read_bytes

# errors that parsers raise at bytes that make no sense; UnicodeDecodeError is a ValueError,
# NotImplementedError a RuntimeError
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
DEMONSTRATIONS = 10_000  # of a file or data set
NUMBERS = 2**24  # in what is read of such a set, or of an NPZ file


class DemonstrationError(LineError):
    """Demonstrations are malformed: one line says where, what was expected and what came."""


@contextmanager
def readable(kind: str, *failures: type[Exception]) -> Iterator[None]:
    """Turn what a library raises at a damaged file into a line of ours.

    Args:
        kind: what the file must be, as in "not a readable <kind>".
        failures: exceptions that only this library has.

    Raises:
        DemonstrationError: one of those was raised, or a common one.

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


def content_of(path: Path, most: int = FILE_BYTES) -> bytes:
    """All of a regular file.

    Raises:
        DemonstrationError: it is a pipe, a device or a folder, or has more than ``most`` bytes.
        OSError: it cannot be opened.
    """
    try:
        return read_bytes(path, most)
    except FileError as error:
        raise DemonstrationError(str(error)) from error


@contextmanager
def opened_set(path: Path) -> Iterator[BinaryIO]:
    """A regular file of a data set, open for reading. Errors as of :func:`content_of`."""
    try:
        with opened(path, SET_BYTES) as file:
            yield file
    except FileError as error:
        raise DemonstrationError(str(error)) from error


def check_count(numbers: int) -> None:
    """Raise DemonstrationError at more numbers than are read of a data set."""
    if numbers > NUMBERS:
        raise DemonstrationError(f"what is read must have at most {NUMBERS} numbers, got {numbers}")


def check_demonstrations(count: int) -> None:
    """Raise DemonstrationError at more demonstrations than are read."""
    if count > DEMONSTRATIONS:
        raise DemonstrationError(
            f"there must be at most {DEMONSTRATIONS} demonstrations, got {count}"
        )


@contextmanager
def within(where: object) -> Iterator[None]:
    """Say in which file something is wrong.

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
    except DemonstrationError as error:
        raise DemonstrationError(f"{where}: {error}") from error.__cause__


def optional(module: str) -> ModuleType:
    """Import a library that not everybody has.

    Args:
        module: dotted name.

    Raises:
        ImportError: it is missing; the message says how to get it.

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
