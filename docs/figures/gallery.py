"""Make ``docs/figures/robots``: a film of each robot of the package that learns, of seed 0.

    python docs/figures/gallery.py [NAME ...]

What was learned already in ``runs/NAME/seed_0`` is not learned again. It needs OpenGL.
"""

from __future__ import annotations

import subprocess
import sys
from itertools import islice
from pathlib import Path

from PIL import Image, ImageSequence

from torch_pmil.tasks.registry import EXPERIMENTS

FILMS = Path(__file__).parent / "robots"
WIDTH, COLOURS, EVERY = 240, 128, 2  # pixels, colours, and which frames are kept
LETTER = "demonstrations=lasa:Sshape"
ROBOTS = sorted(EXPERIMENTS.keys() - {"double_pendulum_pilco"})  # which moves as imitation does


def film(name: str) -> None:
    """Learn one robot, and keep its film."""
    run = Path("runs", name, "seed_0")
    settings = [f"experiment={name}", f"out={run}", "resume=true"]
    settings += [LETTER] if name.startswith("handwriting") else []
    subprocess.run([sys.executable, "-m", "torch_pmil", "train", *settings], check=True)
    FILMS.mkdir(exist_ok=True)
    with Image.open(run / "video.gif") as video:
        size, pause = (WIDTH, WIDTH * video.height // video.width), EVERY * video.info["duration"]
        kept = islice(ImageSequence.Iterator(video), 0, None, EVERY)
        frames = [frame.convert("RGB").resize(size) for frame in kept]
    colours = frames[0].quantize(COLOURS, Image.Quantize.MAXCOVERAGE)  # the small links too
    shown = {"palette": colours, "dither": Image.Dither.NONE}  # what stands still stays the same
    first, *others = (frame.quantize(**shown) for frame in frames)
    in_time = {"save_all": True, "append_images": others, "duration": pause, "loop": 0}
    first.save(FILMS / f"{name}.gif", **in_time)


def main() -> None:
    """Film the robots that are named, or all."""
    for name in sys.argv[1:] or ROBOTS:
        film(name)


if __name__ == "__main__":
    main()
