"""Show a learned policy from fresh starts: in a window, or in a GIF if there is no screen.

Example:
    pmil play
    pmil play runs/double_pendulum/seed_0
    pmil play runs/double_pendulum/seed_0 --out swing_ups.mp4 --starts 5

Without a run it shows a policy that comes with the package: the double pendulum's swing-up,
learned from five demonstrations and 22.5 s on the robot.
"""

from __future__ import annotations

import secrets
import sys
from pathlib import Path

from torch_pmil.checks import check_whole
from torch_pmil.cli import check_new, errors_in_one_line, parser_of
from torch_pmil.plotting.video import check_film_name
from torch_pmil.runs.playing import SHIPPED, load_player
from torch_pmil.runs.viewer import has_screen

FILM = Path("play.gif")


def main() -> None:
    """Read the command line, load, show."""
    parser = parser_of(__doc__)
    option, film = parser.add_argument, f".gif or .mp4 file (default {FILM}, if there is no screen)"
    option("run", nargs="?", type=Path, metavar="RUN", help="folder of a finished run")
    option("--out", type=Path, help=film)
    option("--starts", type=int, default=1, help="number of motions in the file (default 1)")
    seed = secrets.randbelow(2**31)
    option("--seed", type=int, default=seed, help="seed of the starts (default: a random one)")
    arguments = parser.parse_args()
    out, starts = arguments.out or FILM, arguments.starts
    try:
        with errors_in_one_line(ImportError, ValueError, OSError, RuntimeError):
            check_whole("--starts", starts, 1)
            check_film_name(out)
            player = load_player(arguments.run or SHIPPED)
            name, seconds = player.task.name, player.task.horizon * player.policy.control_period
            if arguments.out is None and player.in_simulator and has_screen():
                print(f"{name}: close the window, or press Ctrl-C, to end", flush=True)
                player.show(arguments.seed)
                return
            check_new(out)
            succeeded = player.film(out, starts, arguments.seed)
    except KeyboardInterrupt:
        sys.exit(130)
    motions = f"{starts} {'motion' if starts == 1 else 'motions'} of {seconds:g} s"
    result = f"{motions} from a fresh start, {succeeded} of {starts} with success"
    print(f"wrote {out}: {name}, {result}")
