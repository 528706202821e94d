"""Continue a run that was stopped, or one that needs more trials.

Example:
    pmil resume runs/double_pendulum/seed_0
    pmil resume runs/double_pendulum/seed_0 trials=24

Call it in the folder in which the run was started, if its settings have relative paths.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from torch_pmil.cli import errors_in_one_line, parser_of, train
from torch_pmil.files import short
from torch_pmil.runs.printing import own_experiment
from torch_pmil.runs.run_folder import read_command
from torch_pmil.runs.settings import SETTINGS, word_of
from torch_pmil.runs.summaries import RunError

FIXED = {"out", "resume", "overwrite", "settings"}  # what says which run it is, and what is done


def main() -> None:
    """Read the command line, and train with the run's own settings."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, metavar="RUN", help="folder of the run")
    change = "settings to change, as trials=24"
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE", help=change)
    arguments = parser.parse_args()
    with errors_in_one_line(RunError, OSError):
        sys.argv = ["pmil train", *overrides(arguments.folder, arguments.settings)]
    train.main()


def overrides(folder: Path, changed: list[str]) -> list[str]:
    """The settings of a run with some of them changed, and with the present name of its folder.

    Raises:
        RunError: the run was not started by ``pmil train``, or a change is not one of its settings.
        OSError: the folder does not record how the run was started.
    """
    words = read_command(folder)
    if words[:2] != ["pmil", "train"]:
        raise RunError(
            f"{folder} was begun by {shlex.join(words)}, not by pmil train: go on in Python, by "
            "learn(resume=True)"
        )
    if fixed := FIXED & {word.partition("=")[0] for word in changed}:
        raise RunError(f"pmil resume cannot change {', '.join(sorted(fixed))}")
    for word in words[2:]:
        # Hydra's own settings can name functions that it calls, and its flags other folders. A
        # reference to another setting could hide the name of a module
        name, equals, value = word.partition("=")
        if not equals or name not in SETTINGS or (name == "experiment" and "$" in value):
            raise RunError(
                f"{folder}: run.json is damaged: a setting must be NAME=VALUE, got {short(word)}"
            )
    own = own_experiment(words[2:])
    if own and not any(word.startswith("experiment=") for word in changed):
        raise RunError(
            f"{folder} is of a task of one's own, whose module would be executed: if you trust it, "
            f"go on with: pmil resume {shlex.join([str(folder), own[0]])}"
        )
    new = [*changed, word_of("out", str(folder)), "resume=true"]
    names = {setting.partition("=")[0] for setting in new} | {"overwrite"}
    return [word for word in words[2:] if word.partition("=")[0] not in names] + new
