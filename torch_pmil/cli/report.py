"""Write the report of a finished run again, from the numbers, figures and video in its folder.

Example:
    pmil report runs/double_pendulum/seed_0
"""

from __future__ import annotations

from pathlib import Path

from torch_pmil.cli import errors_in_one_line, parser_of
from torch_pmil.runs.printing import making_the_rest
from torch_pmil.runs.report import write_report
from torch_pmil.runs.summaries import RunError, read_summary


def main() -> None:
    """Read the command line, write, print where."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, metavar="RUN", help="folder of a finished run")
    folder = parser.parse_args().folder
    with errors_in_one_line(RunError, OSError):
        page = write_report(folder)
        command = str(read_summary(folder).get("command", ""))
    there = {
        "figures (there are none)": any((folder / "figures").glob("[!.]*.png")),
        "video (there is no video.mp4)": (folder / "video.mp4").exists(),
    }
    missing = " and ".join(words for words, found in there.items() if not found)
    remedy = making_the_rest(folder) if command.startswith("pmil train") else "learn(resume=True)"
    absent = f", without {missing}: {remedy} makes what the robot allows" if missing else ""
    print(f"wrote {page}{absent}")
