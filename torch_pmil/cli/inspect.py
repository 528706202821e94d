"""Describe a file of recordings, and list what training needs beyond it.

Example:
    pmil inspect recorded.csv --draw recorded.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

from torch_pmil import plotting
from torch_pmil.checks import check_positive
from torch_pmil.cli import add_reading, check_new, check_picture, errors_in_one_line, parser_of
from torch_pmil.demonstrations import load_recordings
from torch_pmil.demonstrations.inspection import advice, describe


def main() -> None:
    """Read, print what was understood, draw it if asked."""
    parser = parser_of(__doc__)
    formats = "or folder: NPZ, CSV, LASA, Minari, robomimic or LeRobot"
    parser.add_argument("file", type=Path, metavar="FILE", help=formats)
    add_reading(parser, "--recorded-time-step")
    period = "of the robot that will move, in s (default 0.1)"
    parser.add_argument("--control-period", type=float, default=0.1, metavar="S", help=period)
    drawn = "draw each entry over time, and paths in a plane"
    parser.add_argument("--draw", type=Path, metavar="OUT.png", help=drawn)
    arguments = parser.parse_args()
    file, keys, names = arguments.file, arguments.keys, arguments.names
    if arguments.draw:
        check_new(arguments.draw)
        check_picture(arguments.draw)
    with errors_in_one_line(ValueError, ImportError, OSError):
        check_positive("--control-period", arguments.control_period)
        read = load_recordings(file, keys=keys, names=names, time_step=arguments.recorded_time_step)
        print(f"{file}\n\n{describe(read)}\n")
        found = advice(read, str(file), arguments.control_period, _options(arguments))
        steps = found or ["nothing to do: it is loaded as it is"]
        print("before training", *(f"- {line}" for line in steps), sep="\n")
        if arguments.draw:
            shown = read.labels, read.times, read.values, read.names, read.units
            plotting.save_figure(plotting.plot_recordings(*shown), arguments.draw)
            print(f"\nwrote {arguments.draw}")


def _options(arguments: argparse.Namespace) -> list[str]:
    """The options with which ``pmil align`` reads the file in the same way."""
    given = {"--keys": arguments.keys, "--names": arguments.names}
    options = [text for option, names in given.items() if names for text in (option, *names)]
    if arguments.recorded_time_step is None:
        return options
    return [*options, "--recorded-time-step", f"{arguments.recorded_time_step:g}"]
