"""Reproduce an experiment of the paper: its numbers and figures, into results/paper/NAME.

Example:
    python scripts/reproduce.py figure6
    python scripts/reproduce.py figure6 --quick

What was learned before is not learned again, and what was stopped goes on. A quick reproduction
takes minutes, and has results of its own, in results/quick, from smaller runs.
"""

from __future__ import annotations

import argparse
import shlex
import sys

from reproduction import PAPER
from reproduction.reproduction import ends_in_one_line, reproduce


def main() -> None:
    """Learn, write, say where."""
    names = "\n".join(f"  {name:10} {experiment.shows}" for name, experiment in PAPER.items())
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n")[0],
        epilog=f"experiments:\n{names}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", choices=PAPER, help=", ".join(PAPER))
    parser.add_argument(
        "--quick", action="store_true", help="in minutes: fewer trials and fewer samples"
    )
    arguments = parser.parse_args()
    command = shlex.join(["python", "scripts/reproduce.py", *sys.argv[1:]])
    with ends_in_one_line(command):
        out, results = reproduce(PAPER[arguments.name], arguments.quick, command)
    for name, value in results.headline.items():
        print(f"{name}: {'none' if value is None else f'{value:.4g}'}")
    files = [f"{out}/summary.json", *(f"{out}/{name}.png" for name in results.figures)]
    print(f"see {', '.join(files)}")


if __name__ == "__main__":
    main()
