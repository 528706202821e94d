"""The commands of ``pmil``, one file each."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import version

COMMANDS = {  # in the order in which they are used; each is the module of that name
    "inspect": "say what is in a file of recordings, and what training needs beside it",
    "align": "make demonstrations of recordings: condition, align, resample",
    "draw": "draw demonstrations by hand, in the browser of this machine",
    "train": "learn an experiment from its demonstrations",
    "resume": "go on with a run that was stopped",
    "report": "write the report of a finished run anew",
    "summarize": "put several runs together: table, main numbers, learning curve",
    "export": "export a learned policy as a program that needs PyTorch alone",
}
EXAMPLES = """\
examples:
  pmil train trials=2                    the double pendulum, into runs/double_pendulum/seed_0
  pmil train experiment=biorob seed=3    another task and seed; all settings: pmil train --help
  pmil train -m "seed=range(10)"         ten seeds, as many at once as there are cores
  pmil resume runs/double_pendulum/seed_0

the same in Python: import torch_pmil; help(torch_pmil)"""


def main() -> None:
    """Run the command that the command line names."""
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        print(_help())
    elif name == "--version":
        print(f"pmil {version('torch_pmil')}")
    elif name in COMMANDS:
        sys.argv = [f"pmil {name}", *arguments]
        import_module(f"torch_pmil.cli.{name}").main()
    else:
        sys.exit(f"error: the command must be one of {', '.join(COMMANDS)}, got {name!r}")


def _help() -> str:
    """All commands on one screen."""
    commands = "\n".join(f"  {name:10} {help}" for name, help in COMMANDS.items())
    return (
        "usage: pmil COMMAND ...\n\nTeach a robot from a few demonstrations.\n\n"
        f"commands (pmil COMMAND --help says more):\n{commands}\n\n{EXAMPLES}"
    )
