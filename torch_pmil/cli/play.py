"""Show a learned policy move from fresh starts: in a window, or in a GIF where there is no screen.

Example:
    pmil play
    pmil play runs/double_pendulum/seed_0
    pmil play runs/double_pendulum/seed_0 --out swing_ups.mp4 --starts 5

Without a run it is a policy that comes with the package: the double pendulum's swing-up, learned
from five demonstrations and 22.5 s on the robot.
"""

from __future__ import annotations

import secrets
import sys
from argparse import Namespace
from pathlib import Path

from torch_pmil.checks import check_whole
from torch_pmil.cli import Parser
from torch_pmil.files import in_words
from torch_pmil.plotting.video import check_film_name
from torch_pmil.runs.playing import SHIPPED, Player, load_player
from torch_pmil.runs.viewer import has_screen

FILM = Path("play.gif")


def main() -> None:
    """Read the command line, load, show."""
    arguments = parsed()
    try:
        check_whole("--starts", arguments.starts, 1)
        check_film_name(arguments.out or FILM)
        player = load_player(arguments.run or SHIPPED)
        if arguments.out is None and player.in_simulator and has_screen():
            print(
                f"{player.experiment.name}: close the window, or press Ctrl-C, to end", flush=True
            )
            player.show(arguments.seed)
        else:
            film(player, arguments.out or FILM, arguments.starts, arguments.seed)
    except (ImportError, ValueError, OSError, RuntimeError) as error:
        sys.exit(f"error: {in_words(error)}")
    except KeyboardInterrupt:
        sys.exit(130)


def parsed() -> Namespace:
    """The command line."""
    summary, _, more = __doc__.partition("\n")
    parser = Parser(description=summary, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("run", nargs="?", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument(
        "--out", type=Path, help=f"file to write, .gif or .mp4 ({FILM} where there is no screen)"
    )
    parser.add_argument(
        "--starts", type=int, default=1, help="number of motions in the file (default 1)"
    )
    parser.add_argument(
        "--seed", type=int, default=secrets.randbelow(2**31), help="of the starts (default: any)"
    )
    return parser.parse_args()


def film(player: Player, path: Path, starts: int, seed: int) -> None:
    """Write the file, and say what is in it."""
    succeeded = player.film(path, starts, seed)
    seconds = player.experiment.horizon * player.policy.control_period
    motions = "motion" if starts == 1 else "motions"
    print(
        f"wrote {path}: {player.experiment.name}, {starts} {motions} of {seconds:g} s from a fresh "
        f"start, {succeeded} of {starts} with success"
    )
