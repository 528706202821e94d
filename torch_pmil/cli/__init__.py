"""The commands of ``pmil``, one file each."""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from torch_pmil.files import in_words

if TYPE_CHECKING:
    from torch_pmil.demonstrations import Demonstrations

COMMANDS = {  # in the order in which they are used; each is the module of that name
    "play": "show a learned policy: that of a run, or one that comes with the package",
    "new": "write a template: your own robot, its demonstrations, and a script that learns",
    "inspect": "describe a file of recordings, and list what training needs beyond it",
    "align": "make demonstrations from recordings: filter, align, resample",
    "draw": "draw demonstrations by hand, in the browser of this machine",
    "train": "learn an experiment from its demonstrations",
    "resume": "continue a run that was stopped",
    "report": "write the report of a finished run again",
    "summarize": "combine several runs: table, main numbers, learning curve",
    "export": "export a learned policy as a program of PyTorch or of ONNX",
    "compile": "compile the prediction for this processor now, not in the first training",
}
HELP = """\
usage: pmil COMMAND ...

Teach a robot from a few demonstrations.

commands (pmil COMMAND --help explains each):
{}

examples:
  pmil train trials=2                    the double pendulum, into runs/double_pendulum/seed_0
  pmil train experiment=biorob seed=3    another task and seed; all settings: pmil train --help
  pmil train -m "seed=range(10)"         ten seeds, as many at once as there are cores
  pmil resume runs/double_pendulum/seed_0

the same in Python: import torch_pmil; help(torch_pmil)"""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        """End the command with what is wrong with its command line."""
        self.exit(2, f"error: {message} (see {self.prog} --help)\n")


def parser_of(doc: str | None) -> Parser:
    """A parser whose help is the docstring of the command's module."""
    summary, _, more = (doc or "").partition("\n\n")
    raw = argparse.RawDescriptionHelpFormatter
    return Parser(description=summary, epilog=more, formatter_class=raw)


def add_reading(parser: Parser, time_step: str) -> None:
    """Add the options that say how a recording is read; ``time_step`` names the last one."""
    listed = partial(parser.add_argument, nargs="+", default=[])
    listed("--keys", metavar="KEY", help="what to read: keys, columns or entries")
    listed("--names", metavar="NAME", help="names of the entries, in place of the file's")
    step = "between samples, in s, if the file has no times"
    parser.add_argument(time_step, type=float, metavar="S", help=step)


@contextmanager
def errors_in_one_line(*kinds: type[Exception]) -> Iterator[None]:
    """End the command with what an error of these kinds says."""
    try:
        yield
    except kinds as error:
        sys.exit(f"error: {in_words(error)}")


def check_out(out: Path) -> None:
    """End the command unless demonstrations can be written to a file of this name."""
    if out.suffix != ".npz":
        sys.exit(f"error: {out}: demonstrations are written to a .npz file")
    if not out.parent.is_dir():
        sys.exit(f"error: {out}: there is no folder {out.parent}")


def check_new(path: Path) -> None:
    """End the command if there is a file of this name: no command replaces what it did not make."""
    if os.path.lexists(path):
        sys.exit(f"error: {path} is there already: choose another name")


def check_picture(path: Path) -> None:
    """End the command if a picture would be written to a file of another kind."""
    if path.suffix.lower() != ".png":
        sys.exit(f"error: {path}: a picture is written to a .png file")


def print_written(out: Path, demonstrations: Demonstrations) -> None:
    """Print what a file of demonstrations holds."""
    (count, samples, _), duration = demonstrations.positions.shape, demonstrations.duration
    print(f"wrote {out}: {count} demonstrations of {samples} samples, {duration:g} s")


class LastingOutput:
    """A text stream that drops what is written to it once it is broken.

    So a command does not stop half way if its reader leaves (``| head``) or the disk is full.
    Characters that the encoding of the stream does not have are written as ``?``.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.failure: OSError | None = None
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or drop it; returns its length."""
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
        """Redirect the stream's file to the null device, with what is left in buffers."""
        self.failure = error
        with suppress(OSError):  # a stream may have no file
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


@contextmanager
def lasting_output() -> Iterator[None]:
    """Nothing that is printed within raises, even if standard output or error breaks."""
    with ExitStack() as stack:
        for name in ("stdin", "stdout", "stderr"):  # each opens the lowest number that is free
            if getattr(sys, name) is None:  # the caller closed it
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
    """The error of standard output since the last call, or None.

    A reader that left is not an error.
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
        try:
            _run()
        except KeyboardInterrupt:
            print("\nstopped", file=sys.stderr)
            sys.exit(130)
        if lost := lost_output():
            sys.exit(f"error: standard output: {lost.strerror}")


def _run() -> None:
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        print(HELP.format("\n".join(f"  {name:10} {help}" for name, help in COMMANDS.items())))
    elif name == "--version":
        print(f"pmil {version('torch_pmil')}")
    elif name in COMMANDS:
        sys.argv = [f"pmil {name}", *arguments]
        _imported(name).main()
    else:
        sys.exit(f"error: the command must be one of {', '.join(COMMANDS)}, got {name!r}")


def _imported(name: str) -> ModuleType:
    """The module of a command, whose imports are excluded from garbage collection.

    They never become garbage, and it would take seconds to search them again and again.
    """
    gc.disable()
    try:
        return import_module(f"torch_pmil.cli.{name}")
    finally:
        gc.freeze()
        gc.enable()
