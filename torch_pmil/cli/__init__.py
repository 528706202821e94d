"""The commands of ``pmil``, one file each."""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from importlib.metadata import version
from types import ModuleType
from typing import Any, NoReturn, TextIO

COMMANDS = {  # in the order in which they are used; each is the module of that name
    "play": "show a learned policy move; without a run, one that comes with the package",
    "new": "write a template of a robot of one's own, with what learns on it",
    "inspect": "say what is in a file of recordings, and what training needs beside it",
    "align": "make demonstrations of recordings: condition, align, resample",
    "draw": "draw demonstrations by hand, in the browser of this machine",
    "train": "learn an experiment from its demonstrations",
    "resume": "go on with a run that was stopped",
    "report": "write the report of a finished run anew",
    "summarize": "put several runs together: table, main numbers, learning curve",
    "export": "export a learned policy as a program that needs PyTorch alone",
    "compile": "compile the prediction for this processor, once; or the first training does",
}
EXAMPLES = """\
examples:
  pmil train trials=2                    the double pendulum, into runs/double_pendulum/seed_0
  pmil train experiment=biorob seed=3    another task and seed; all settings: pmil train --help
  pmil train -m "seed=range(10)"         ten seeds, as many at once as there are cores
  pmil resume runs/double_pendulum/seed_0

the same in Python: import torch_pmil; help(torch_pmil)"""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, without the usage, which ``--help`` shows."""

    def error(self, message: str) -> NoReturn:
        """End the command with what is wrong with its command line."""
        self.exit(2, f"error: {message} ({self.prog} --help lists what it takes)\n")


class LastingOutput:
    """A text stream that may break: from then on, what is written to it goes nowhere.

    So a reader that leaves (``| head``) or a disk that is full ends no command half way. What no
    encoding of the stream has is written as ``?``.

    Args:
        stream: to write to.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.failure: OSError | None = None
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or nothing; returns its length."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._fall_silent(error)
            return len(text)

    def flush(self) -> None:
        """Hand on what was written, or drop it."""
        try:
            self._stream.flush()
        except OSError as error:
            self._fall_silent(error)

    def _fall_silent(self, error: OSError) -> None:
        """Let the stream's file be the null device, so that what is left in buffers goes there."""
        self.failure = error
        with suppress(OSError):  # a stream may have no file
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


@contextmanager
def lasting_output() -> Iterator[None]:
    """Nothing that is printed within raises, whatever becomes of standard output and error."""
    with ExitStack() as stack:
        for name in ("stdin", "stdout", "stderr"):  # each opens the lowest number that is free
            if getattr(sys, name) is None:  # closed by whoever called
                stack.callback(setattr, sys, name, None)
                setattr(sys, name, stack.enter_context(open(os.devnull, "r+")))
        for name in ("stdout", "stderr"):
            stream = getattr(sys, name)
            if not isinstance(stream, LastingOutput):
                setattr(sys, name, lasting := LastingOutput(stream))
                stack.callback(setattr, sys, name, stream)
                stack.callback(lasting.flush)
        yield


def lost_output() -> OSError | None:
    """What standard output failed with since it was last asked, or None.

    A reader that leaves has lost nothing.
    """
    if not isinstance(sys.stdout, LastingOutput):
        return None
    sys.stdout.flush()
    failure, sys.stdout.failure = sys.stdout.failure, None
    return None if isinstance(failure, BrokenPipeError) else failure


def main() -> None:
    """Run the command that the command line names."""
    with lasting_output():
        try:
            os.getcwd()
        except OSError as error:
            sys.exit(f"error: the working folder cannot be used: {error.strerror}")
        _run()
        if lost := lost_output():
            sys.exit(f"error: standard output: {lost.strerror}")


def _run() -> None:
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        print(_help())
    elif name == "--version":
        print(f"pmil {version('torch_pmil')}")
    elif name in COMMANDS:
        sys.argv = [f"pmil {name}", *arguments]
        _imported(name).main()
    else:
        sys.exit(f"error: the command must be one of {', '.join(COMMANDS)}, got {name!r}")


def _imported(name: str) -> ModuleType:
    """The module of a command, with what it imports left out of garbage collection.

    None of it ever becomes garbage, and there is so much of it that to look through it again and
    again, and once more at the end of the process, would take seconds.
    """
    gc.disable()
    try:
        return import_module(f"torch_pmil.cli.{name}")
    finally:
        gc.freeze()
        gc.enable()


def _help() -> str:
    """All commands on one screen."""
    commands = "\n".join(f"  {name:10} {help}" for name, help in COMMANDS.items())
    return (
        "usage: pmil COMMAND ...\n\nTeach a robot from a few demonstrations.\n\n"
        f"commands (pmil COMMAND --help says more):\n{commands}\n\n{EXAMPLES}"
    )
