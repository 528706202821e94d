"""Say what is in a file of recordings, and what training needs beside it.

Example:
    pmil inspect recorded.csv --draw recorded.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from torch_pmil.checks import check_positive
from torch_pmil.cli import Parser
from torch_pmil.demonstrations import load_recordings
from torch_pmil.demonstrations.inspection import advice, describe
from torch_pmil.files import in_words
from torch_pmil.plotting import plot_recordings, save_figure


def main() -> None:
    """Read, say what was understood, draw it if asked."""
    arguments = _parser().parse_args()
    try:
        check_positive("--control-period", arguments.control_period)
        recordings = load_recordings(
            arguments.file,
            keys=arguments.keys,
            names=arguments.names,
            time_step=arguments.time_step,
        )
        print(f"{arguments.file}\n\n{describe(recordings)}\n")
        options = _options(arguments)
        found = advice(recordings, str(arguments.file), arguments.control_period, options)
        steps = found or ["nothing to do: it is loaded as it is"]
        print("before training", *(f"- {line}" for line in steps), sep="\n")
        if arguments.draw:
            figure = plot_recordings(
                recordings.labels,
                recordings.times,
                recordings.values,
                recordings.names,
                recordings.units,
            )
            save_figure(figure, arguments.draw)
            print(f"\nwrote {arguments.draw}")
    except (ValueError, ImportError, OSError) as error:
        sys.exit(f"error: {in_words(error)}")


def _options(arguments: argparse.Namespace) -> list[str]:
    """The options that say how the file is read."""
    given = {"--keys": arguments.keys, "--names": arguments.names}
    options = [text for option, names in given.items() if names for text in (option, *names)]
    if arguments.time_step is None:
        return options
    return [*options, "--recorded-time-step", f"{arguments.time_step:g}"]


def _parser() -> argparse.ArgumentParser:
    parser = Parser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "file",
        type=Path,
        metavar="FILE",
        help="or folder: NPZ, CSV, LASA, Minari, robomimic or LeRobot",
    )
    parser.add_argument(
        "--keys",
        nargs="+",
        default=[],
        metavar="KEY",
        help="what to read of it: keys, columns or entries",
    )
    parser.add_argument(
        "--names",
        nargs="+",
        default=[],
        metavar="NAME",
        help="of the entries, in place of the file's",
    )
    parser.add_argument(
        "--time-step", type=float, help="between samples, in s, where the file has no times"
    )
    parser.add_argument(
        "--control-period", type=float, default=0.1, help="of the robot that is to move, in s (0.1)"
    )
    parser.add_argument(
        "--draw",
        type=Path,
        metavar="OUT.png",
        help="draw each entry over time, and paths in a plane",
    )
    return parser
