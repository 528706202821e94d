"""Draw the BioRob: at its start, whole and its drives, and with the balls of several targets.

Example:
    MUJOCO_GL=egl python scripts/draw_biorob.py biorob.png biorob_targets.png

Both pictures of the documentation are in docs/figures/.
"""

from __future__ import annotations

import sys

import matplotlib.image
import mujoco
import numpy as np

from reproduction.target_picture import draw_targets
from torch_pmil.envs.biorob import biorob_model
from torch_pmil.envs.mujoco_model import open_renderer
from torch_pmil.files import in_words

SIZE = 560  # pixels


def draw_start() -> np.ndarray:
    """Draw two pictures side by side: the whole robot, and its drives."""
    model = biorob_model()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    views = []
    with open_renderer(model, (SIZE, SIZE)) as renderer:
        for camera in ("front", "drives"):
            renderer.update_scene(data, camera=camera)
            views.append(renderer.render())
    return np.hstack(views)


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit(f"expected two arguments, the pictures' paths, got {len(sys.argv) - 1}")
    try:
        for path, picture in zip(sys.argv[1:], (draw_start(), draw_targets()), strict=True):
            matplotlib.image.imsave(path, picture)
    except (OSError, RuntimeError, ValueError) as error:
        sys.exit(f"cannot draw: {in_words(error)}")


if __name__ == "__main__":
    main()
