"""What is wrong with a file, in one line."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


class DemonstrationError(ValueError):
    """Demonstrations are malformed; the message says where, what was expected and what came, in one line."""


@contextmanager
def readable(kind: str, *failures: type[Exception]) -> Iterator[None]:
    """Turn what a library raises at a damaged file into a line of ours.

    Args:
        kind: what the file must be, as in "not a readable <kind>".
        failures: exceptions of the library.

    Raises:
        DemonstrationError: one of those was raised.

    Example:
        >>> with readable("number", ValueError):
        ...     float("five")
        Traceback (most recent call last):
        torch_pmil.demonstrations.errors.DemonstrationError: not a readable number (could not convert string to float: 'five')
    """
    try:
        yield
    except DemonstrationError:
        raise
    except failures as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DemonstrationError(f"not a readable {kind} ({reason})") from error


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
        raise ImportError(f"reading this format needs {module.partition('.')[0]}: pip install 'torch_pmil[formats]'") from error
