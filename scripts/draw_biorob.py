"""Draw the BioRob at its start, whole and its drives: ``MUJOCO_GL=egl python scripts/draw_biorob.py docs/biorob.png``."""

from __future__ import annotations

import sys

import matplotlib.image
import mujoco
import numpy as np

from torch_pmil.envs.biorob import biorob_model

SIZE = 560  # pixels


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(f"expected one argument, the picture's path, got {len(sys.argv) - 1}")
    model = biorob_model()
    model.vis.global_.offheight = model.vis.global_.offwidth = SIZE
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    views = []
    with mujoco.Renderer(model, SIZE, SIZE) as renderer:
        for camera in ("front", "drives"):
            renderer.update_scene(data, camera=camera)
            views.append(renderer.render())
    matplotlib.image.imsave(sys.argv[1], np.hstack(views))


if __name__ == "__main__":
    main()
