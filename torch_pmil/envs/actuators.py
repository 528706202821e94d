r"""Kinds of actuators in a MuJoCo model: motors, and servos of positions or velocities.

A servo's force is :math:`g\,u + b_0 + b_1 l + b_2 \dot l` of its action u and the length l of its
transmission (the angle of a joint), within its force range: :math:`g = k_p, b_1 = -k_p, b_2 = -k_v`
of a position servo, :math:`g = k_v, b_2 = -k_v` of a velocity servo. A motor has :math:`g = 1` and
no b.
"""

from __future__ import annotations

import mujoco
import numpy as np

from torch_pmil.envs.robot import Array

# of an action, at an actuator that turns, and at one that pulls
UNITS = {
    "motor": ("N·m", "N"),
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "other": ("", ""),
}


def actuator_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the actuators in the model, or their numbers."""
    numbers = range(model.nu)
    return tuple(model.actuator(number).name or str(number) for number in numbers)


def actuator_kinds(model: mujoco.MjModel) -> tuple[str, ...]:
    """Kind of each actuator: "motor", "position" or "velocity" (servos), or "other".

    Example:
        >>> from torch_pmil.envs.double_pendulum import double_pendulum_model
        >>> actuator_kinds(double_pendulum_model())
        ('motor', 'motor')
    """
    return tuple(_kind(model, number) for number in range(model.nu))


def actuator_units(model: mujoco.MjModel) -> tuple[str, ...]:
    """Unit of each action, "" if unknown."""
    kinds = enumerate(actuator_kinds(model))
    return tuple(UNITS[kind][not _turns(model, number)] for number, kind in kinds)


def force_limits(model: mujoco.MjModel) -> Array:
    """Largest forces of the actuators on their joints (F,), N·m or N; infinite without a limit."""
    servo = np.array([kind != "motor" for kind in actuator_kinds(model)])
    force = np.where(model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(-1), np.inf)
    by_action = np.where(servo, np.inf, np.abs(model.actuator_ctrlrange).max(-1))
    return np.abs(model.actuator_gear[:, 0]) * np.minimum(force, by_action)


def actions_for(model: mujoco.MjModel, forces: Array, positions: Array) -> Array:
    """Actions (S, F) of actuators at rest that give their joints forces (S, F), N·m or N.

    Each actuator moves one joint; ``positions`` (S, F) are those of the joints, rad or m.
    """
    gear = model.actuator_gear[:, 0]
    b_0, b_1, _ = _bias(model)
    return (forces / gear - b_0 - b_1 * gear * positions) / model.actuator_gainprm[:, 0]


def _bias(model: mujoco.MjModel) -> Array:
    """b_0, b_1 and b_2 of each actuator, (3, F)."""
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    return np.where(affine, model.actuator_biasprm[:, :3].T, 0.0)


def _kind(model: mujoco.MjModel, number: int) -> str:
    gain, (b_0, b_1, b_2) = model.actuator_gainprm[number, 0], _bias(model)[:, number]
    fixed = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_FIXED
    direct = model.actuator_dyntype[number] == mujoco.mjtDyn.mjDYN_NONE
    if not (fixed and direct and gain > 0 and b_0 == 0):
        return "other"
    if b_1 == b_2 == 0:
        return "motor" if gain == 1 else "other"
    if b_1 == -gain:
        return "position"
    return "velocity" if (b_1, b_2) == (0, -gain) else "other"


def _turns(model: mujoco.MjModel, number: int) -> bool:
    """Whether an actuator acts on a hinge, not on a slide or a tendon."""
    joint = model.actuator_trnid[number, 0]
    of_joint = model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_JOINT
    return bool(of_joint and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE)
