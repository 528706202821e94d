"""Write a template: a robot of one's own, demonstrations for it, and what learns on it.

Example:
    pmil new robot
    pmil new robot my_arm
"""

from __future__ import annotations

import shlex
import sys
from importlib import resources
from pathlib import Path

from torch_pmil.cli import Parser
from torch_pmil.files import in_words, replacing

TEMPLATE = resources.files("torch_pmil.cli") / "new_robot"
NEXT = """\
  robot.py            an arm with one joint; four places are marked to make it yours
  demonstrations.csv  five motions of the arm
  train.py            learns to move like them
next: cd {folder} && python train.py"""


def main() -> None:
    """Read the command line, write, say what and what is next."""
    parser = Parser(description=__doc__.partition("\n")[0])
    parser.add_argument("kind", choices=["robot"], metavar="robot", help="what to write")
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        default=Path("my_robot"),
        metavar="FOLDER",
        help="folder to write to (default: my_robot)",
    )
    folder = parser.parse_args().folder
    try:
        write_template(folder)
    except OSError as error:
        sys.exit(f"error: {in_words(error)}")
    print(f"wrote {folder}/\n{NEXT.format(folder=shlex.quote(str(folder)))}")


def write_template(folder: Path) -> None:
    """Write all files of the template into a folder, which is made if it is not there.

    Raises:
        FileExistsError: one of the files is there already; none is written then.
        OSError: the folder cannot be written to.
    """
    files = {
        folder / source.name.replace("-tpl", ""): source.read_bytes()
        for source in sorted(TEMPLATE.iterdir(), key=lambda file: file.name)
    }
    for path in files:
        if path.exists():
            raise FileExistsError(f"{path} is there already: pmil new replaces nothing")
    folder.mkdir(parents=True, exist_ok=True)
    for path, content in files.items():
        with replacing(path) as temporary:
            temporary.write_bytes(content)
