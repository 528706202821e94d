"""Torques that a motion takes, by MuJoCo's inverse dynamics."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inverse_dynamics(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> Array:
    """Generalised forces (S, V) under which a model moves as given, limits or not.

    Args:
        model: of hinge and slide joints alone.
        positions, velocities, accelerations: of all V joints in the model's order, (S, V).
    """
    data, forces = mujoco.MjData(model), np.empty((len(positions), model.nv))
    for row, parts in enumerate(zip(positions, velocities, accelerations, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = parts
        mujoco.mj_inverse(model, data)
        forces[row] = data.qfrc_inverse
    return forces
