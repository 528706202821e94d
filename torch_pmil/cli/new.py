"""Write a template: your own robot, its demonstrations, and a script that learns.

Example:
    pmil new robot
    pmil new robot my_arm
"""

from __future__ import annotations

import os
import shlex
from importlib import resources
from pathlib import Path
from typing import Any

from torch_pmil.cli import errors_in_one_line, parser_of
from torch_pmil.files import replacing

TEMPLATE = resources.files("torch_pmil.cli") / "new_robot"
NEXT = """\
  robot.py            an arm with one joint; four places are marked to make it yours
  demonstrations.csv  five motions of the arm
  train.py            learns these motions
next: cd {folder} && python train.py"""


def main() -> None:
    """Read the command line, write, print what was written and what comes next."""
    parser = parser_of(__doc__)
    parser.add_argument("kind", choices=["robot"], metavar="robot", help="what to write")
    written = "folder to write to (default my_robot)"
    place: Any = {"nargs": "?", "default": Path("my_robot"), "metavar": "FOLDER", "help": written}
    parser.add_argument("folder", type=Path, **place)
    folder = parser.parse_args().folder
    with errors_in_one_line(OSError):
        write_template(folder)
    print(f"wrote {folder}/\n{NEXT.format(folder=shlex.quote(str(folder)))}")


def write_template(folder: Path) -> None:
    """Write all files of the template into a folder, which is made if it does not exist.

    Raises:
        FileExistsError: one of the files exists already; then nothing is written.
        OSError: the folder cannot be written to.
    """
    files = {
        folder / source.name.replace("-tpl", ""): source.read_bytes()
        for source in sorted(TEMPLATE.iterdir(), key=lambda file: file.name)
    }
    for path in files:
        if os.path.lexists(path):
            raise FileExistsError(f"{path} is there already: pmil new replaces nothing")
    folder.mkdir(parents=True, exist_ok=True)
    for path, content in files.items():
        with replacing(path) as temporary:
            temporary.write_bytes(content)
