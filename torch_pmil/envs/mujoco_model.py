"""A MuJoCo model for a robot: limited actions, columns of its state, pictures."""

from __future__ import annotations

import copy
import itertools
import math
import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch import Tensor

from torch_pmil.envs.actuators import actuator_kinds, actuator_names, actuator_units

ASSETS = Path(__file__).parent / "assets"
WHOLE = 1e-6  # by which a control period may differ from a whole number of time steps
FULL_PHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS


def asset(name: str) -> mujoco.MjSpec:
    """A model file of this package."""
    return mujoco.MjSpec.from_file(str(ASSETS / name))


def open_renderer(model: mujoco.MjModel, pixel_size: tuple[int, int]) -> mujoco.Renderer:
    """A renderer for this height and width. Raises RuntimeError without OpenGL."""
    model.vis.global_.offheight, model.vis.global_.offwidth = pixel_size
    try:
        return mujoco.Renderer(model, *pixel_size)
    except Exception as error:  # each OpenGL platform has its own type of error
        backend = os.environ.get("MUJOCO_GL", "not set")
        raise RuntimeError(
            f"pictures need OpenGL, which failed with MUJOCO_GL {backend} ({error}); headless: "
            "MUJOCO_GL=egl"
        ) from error


def whole_substeps(control_period: float, timestep: float) -> int:
    """Number of time steps in a control period. Raises ValueError unless it is whole."""
    substeps = round(control_period / timestep)
    if substeps < 1 or abs(substeps * timestep - control_period) > 1e-9:
        raise ValueError(
            f"control_period must be a whole number of {timestep} s time steps, got "
            f"{control_period} s"
        )
    return substeps


def dividing_time_step(control_period: float, timestep: float) -> float:
    """The time step if it divides the control period, else the next shorter one that does.

    A shorter one is no less accurate or stable than that of the model. A warning names it.
    """
    steps = math.ceil(control_period / timestep - WHOLE)
    if abs(steps * timestep - control_period) <= WHOLE * timestep:
        return timestep
    chosen = control_period / steps
    warnings.warn(
        f"time step {1e3 * chosen:.5g} ms (the model's is {1e3 * timestep:.5g} ms), so that "
        f"{steps} steps make the control period of {1e3 * control_period:.6g} ms",
        RuntimeWarning,
        stacklevel=3,
    )
    return chosen


def limited_models(
    models: mujoco.MjModel | Sequence[mujoco.MjModel],
    torque_limit: float | Sequence[float] | None,
    count: int,
) -> tuple[mujoco.MjModel, ...]:
    """Copies with limited actions for ``count`` robots, shared by robots of the same model.

    A torque limit applies to the motors.
    """
    models = [models] * count if isinstance(models, mujoco.MjModel) else list(models)
    if len(models) != count:
        raise ValueError(
            f"model must be one or {count} models, one for each robot, got {len(models)}"
        )
    limited = {model: _limited_model(model, torque_limit) for model in set(models)}
    return tuple(limited[model] for model in models)


def _limited_model(
    model: mujoco.MjModel, torque_limit: float | Sequence[float] | None
) -> mujoco.MjModel:
    model = copy.copy(model)
    if torque_limit is not None:
        _limit_motors(model, torque_limit)
    unlimited = np.flatnonzero(model.actuator_ctrllimited == 0)
    if len(unlimited):
        raise ValueError(
            f"actuator {actuator_names(model)[unlimited[0]]} must have a ctrlrange, or inheritrange"
            ", that bounds its actions, got none"
        )
    # Without this flag MuJoCo silently restarts a diverged simulation at its default pose.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.vis.quality.shadowsize = 0
    return model


def _limit_motors(model: mujoco.MjModel, torque_limit: float | Sequence[float]) -> None:
    motors = [kind == "motor" for kind in actuator_kinds(model)]
    limit = np.asarray(torque_limit, dtype=np.float64)
    if limit.shape not in ((), (sum(motors),)) or not (np.isfinite(limit) & (limit > 0)).all():
        units = dict.fromkeys(itertools.compress(actuator_units(model), motors)) or ("N·m",)
        raise ValueError(
            f"torque_limit must be one or {sum(motors)} positive finite numbers in "
            f"{' and '.join(units)}, got {torque_limit}"
        )
    model.actuator_ctrllimited[motors] = 1
    model.actuator_ctrlrange[motors] = np.broadcast_to(limit, sum(motors))[:, None] * [-1, 1]


def at_rest(model: mujoco.MjModel) -> Tensor:
    """Full simulation state (P,) at time 0, in the default pose."""
    physics = np.empty(mujoco.mj_stateSize(model, FULL_PHYSICS))
    mujoco.mj_getState(model, mujoco.MjData(model), physics, FULL_PHYSICS)
    return torch.from_numpy(physics)


def state_columns(model: mujoco.MjModel, joints: Sequence[str], positions_first: bool) -> Tensor:
    """Columns of the joints in MuJoCo's full state [time, qpos, qvel, ...]."""
    observed = [model.joint(name) for name in joints]
    pairs = [[1 + joint.qposadr[0], 1 + model.nq + joint.dofadr[0]] for joint in observed]
    columns = torch.tensor(pairs)
    return (columns.T if positions_first else columns).flatten()
