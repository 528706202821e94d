"""Try an installed ``pmil`` and the README's Python in an empty folder, and print what each takes.

Wall time depends on what else the machine does, processor time hardly.

Example:
    python scripts/check_installed.py build/wheel/.venv/bin/pmil
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
RUN = "runs/double_pendulum/seed_0"
COMMANDS = {  # with what each must leave
    "--version": (),
    "--help": (),
    "play": ("play.gif",),
    "new robot": ("my_robot/robot.py", "my_robot/train.py"),
    "inspect my_robot/demonstrations.csv": (),
    "draw --help": (),
    "train trials=1": (f"{RUN}/policy.pt", f"{RUN}/video.mp4", f"{RUN}/report.html"),
    f"report {RUN}": (),
    f"play {RUN} --out mine.gif": ("mine.gif",),
    f"export {RUN}/policy.pt policy.pt2": ("policy.pt2",),
}
RECORDINGS = "examples/inverted_pendulum.csv"  # of the README's Python
PATIENCE = 600  # s for a command
FIRST_MOTION = 10  # s of processor time, until pmil play has made its file


def main() -> None:
    """Run all commands in turn; exit with 1 at the first that fails, or is too slow to show."""
    if len(sys.argv) != 2:
        sys.exit(f"expected one argument, the installed pmil, got {len(sys.argv) - 1}")
    pmil = Path(sys.argv[1]).absolute()
    with tempfile.TemporaryDirectory() as folder:
        for command, left in COMMANDS.items():
            processor = run_and_say([pmil, *command.split()], Path(folder), left)
            if command == "play" and processor > FIRST_MOTION:
                sys.exit(f"pmil play must show a motion within {FIRST_MOTION} s")
        run_readme(pmil.with_name("python"), Path(folder))


def run_readme(python: Path, folder: Path) -> None:
    """Run the README's Python as a file, beside the recordings that it reads."""
    (lines,) = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(), re.M | re.S)
    (folder / "readme.py").write_text(lines)
    (folder / RECORDINGS).parent.mkdir()
    shutil.copy(ROOT / RECORDINGS, folder / RECORDINGS)
    run_and_say([python, "readme.py"], folder, ("policy.pt",))


def run_and_say(command: list[Path | str], folder: Path, left: tuple[str, ...]) -> float:
    """Run a command, print its times, and return that of processors, s.

    Exits with 1 if it fails, or does not leave these files.
    """
    wall, processor = run(list(map(str, command)), folder)
    words = " ".join([Path(command[0]).name, *map(str, command[1:])])
    print(f"{wall:6.1f} s, of processors {processor:6.1f} s: {words}", flush=True)
    missing = [name for name in left if not (folder / name).is_file()]
    if missing:
        sys.exit(f"{words} did not leave {', '.join(missing)}")
    return processor


def run(command: list[str], folder: Path) -> tuple[float, float]:
    """Wall and processor time (s) of a command, which sees nothing of the clone.

    Exits with 1 if it fails.
    """
    outside = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    before, begin = os.times(), time.monotonic()
    ended = subprocess.run(
        command, cwd=folder, env=outside, capture_output=True, text=True, timeout=PATIENCE
    )
    wall, after = time.monotonic() - begin, os.times()
    if ended.returncode or "error" in ended.stderr.lower():
        sys.exit(f"{' '.join(command)} ended with {ended.returncode}: {ended.stderr[-2000:]}")
    of_user = after.children_user - before.children_user
    return wall, of_user + after.children_system - before.children_system


if __name__ == "__main__":
    main()
