"""Make ``docs/figures/robots``: a film of each robot of the package that learns, of seed 0.

    python docs/figures/gallery.py [NAME ...]

What was learned already in ``runs/NAME/seed_0`` is not learned again. It needs OpenGL.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from torch_pmil.tasks.registry import EXPERIMENTS

FILMS = Path(__file__).parent / "robots"
LETTER = "demonstrations=lasa:Sshape"
ROBOTS = sorted(EXPERIMENTS.keys() - {"acrobot", "double_pendulum_pilco"})  # not learned, the same


def film(name: str) -> None:
    """Learn one robot, and keep its film."""
    run = Path("runs", name, "seed_0")
    settings = [f"experiment={name}", f"out={run}", "resume=true"]
    settings += [LETTER] if name.startswith("handwriting") else []
    subprocess.run([sys.executable, "-m", "torch_pmil", "train", *settings], check=True)
    FILMS.mkdir(exist_ok=True)
    shutil.copyfile(run / "video.gif", FILMS / f"{name}.gif")


def main() -> None:
    """Film the robots that are named, or all."""
    for name in sys.argv[1:] or ROBOTS:
        film(name)


if __name__ == "__main__":
    main()
