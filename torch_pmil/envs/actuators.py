r"""Kinds of actuators in a MuJoCo model: motors, and servos of positions or velocities.

A servo's force is :math:`g\,u + b_0 + b_1 l + b_2 \dot l` of its action u and the length l of its
transmission (the angle of a joint), within its force range: :math:`g = k_p, b_1 = -k_p, b_2 = -k_v`
of a position servo, :math:`g = k_v, b_2 = -k_v` of a velocity servo. A motor has :math:`g = 1` and
no b. A filter of the action does not change the kind; a position servo whose target is the integral
of its action takes a rate.
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
    "rate": ("rad/s", "m/s"),
    "other": ("", ""),
}
DYNAMICS, TRANSMISSION, BIAS = mujoco.mjtDyn, mujoco.mjtTrn, mujoco.mjtBias
# as the numbers that arrays hold
FILTERS = [int(getattr(DYNAMICS, f"mjDYN_{name}")) for name in ("NONE", "FILTER", "FILTEREXACT")]
OF_JOINT = [int(getattr(TRANSMISSION, f"mjTRN_{name}")) for name in ("JOINT", "JOINTINPARENT")]
SCALAR = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
ALONG = [int(getattr(TRANSMISSION, f"mjTRN_{name}")) for name in ("SLIDERCRANK", "BODY")]


def actuator_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the actuators in the model, or their numbers."""
    numbers = range(model.nu)
    return tuple(model.actuator(number).name or str(number) for number in numbers)


def actuator_kinds(model: mujoco.MjModel) -> tuple[str, ...]:
    """Kind of each actuator: "motor", servo of "position", "velocity" or "rate", or "other".

    Example:
        >>> from torch_pmil.envs.double_pendulum import double_pendulum_model
        >>> actuator_kinds(double_pendulum_model())
        ('motor', 'motor')
    """
    return tuple(_kind(model, number) for number in range(model.nu))


def actuator_units(model: mujoco.MjModel) -> tuple[str, ...]:
    """Unit of each action at what it moves, "" if unknown.

    A gear is part of it: "50 N·m" of a motor with gear 50, "0.5 rad" of a servo with gear 2.
    """
    return tuple(_unit(model, *each) for each in enumerate(actuator_kinds(model)))


def force_limits(model: mujoco.MjModel) -> Array:
    """Largest forces of the actuators on their joints (F,), N·m or N; infinite without a limit."""
    servo = np.array([kind != "motor" for kind in actuator_kinds(model)])
    force = np.where(model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(-1), np.inf)
    by_action = np.where(servo, np.inf, np.abs(model.actuator_ctrlrange).max(-1))
    of_actuator = np.abs(model.actuator_gear).max(-1) * np.minimum(force, by_action)
    by_joint = np.isin(model.actuator_trntype, OF_JOINT)
    joints = np.where(by_joint, model.actuator_trnid[:, 0], 0)
    limited = by_joint & model.jnt_actfrclimited[joints].astype(bool)
    of_joint = np.abs(model.jnt_actfrcrange[joints]).max(-1)
    return np.where(limited, np.minimum(of_actuator, of_joint), of_actuator)


def pointing_actions(model: mujoco.MjModel, lengths: Array) -> Array:
    """Targets (nu,) at which servos exert no force at rest, 0 for those without.

    ``lengths`` (nu,) are those of the transmissions, as in ``MjData.actuator_length``.
    """
    b_0, b_1, _ = _bias(model)
    fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    servos = fixed & (b_1 < 0) & (model.actuator_gainprm[:, 0] != 0)
    gains = np.where(servos, model.actuator_gainprm[:, 0], 1.0)
    targets = np.where(servos, -(b_0 + b_1 * lengths) / gains, 0.0)
    ranges = np.where(
        model.actuator_ctrllimited[:, None].astype(bool),
        model.actuator_ctrlrange,
        (-np.inf, np.inf),
    )
    rates = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR
    return np.where(rates, targets, targets.clip(*ranges.T))


def actions_for(model: mujoco.MjModel, forces: Array, positions: Array) -> Array:
    """Actions (S, F) of actuators at rest that give their joints forces (S, F), N·m or N.

    Each actuator moves one joint; ``positions`` (S, F) are those of the joints, rad or m.
    """
    gear = model.actuator_gear[:, 0]
    b_0, b_1, _ = _bias(model)
    return (forces / gear - b_0 - b_1 * gear * positions) / model.actuator_gainprm[:, 0]


def answer_at_rest(model: mujoco.MjModel) -> bool:
    """Whether actions determine forces at rest; those of muscles and rate servos do not."""
    fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    known = np.isin(model.actuator_biastype, [int(BIAS.mjBIAS_NONE), int(BIAS.mjBIAS_AFFINE)])
    direct = np.isin(model.actuator_dyntype, FILTERS) & (model.actuator_gainprm[:, 0] != 0)
    return bool((fixed & known & direct).all())


def _bias(model: mujoco.MjModel) -> Array:
    """b_0, b_1 and b_2 of each actuator, (3, F)."""
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    return np.where(affine, model.actuator_biasprm[:, :3].T, 0.0)


def _kind(model: mujoco.MjModel, number: int) -> str:
    gain, (b_0, b_1, b_2) = model.actuator_gainprm[number, 0], _bias(model)[:, number]
    fixed = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_FIXED
    dynamics = model.actuator_dyntype[number]
    if fixed and b_0 == 0 and b_1 == -gain < 0 and dynamics == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        return "rate"
    if not (fixed and dynamics in FILTERS and gain > 0 and b_0 == 0):
        return "other"
    if b_1 == b_2 == 0:
        return "motor" if gain == 1 else "other"
    if b_1 == -gain:
        return "position"
    return "velocity" if (b_1, b_2) == (0, -gain) else "other"


def _unit(model: mujoco.MjModel, number: int, kind: str) -> str:
    drive = _drive(model, number)
    if drive is None or kind == "other":
        return ""
    turns, gear = drive
    factor, unit = gear if kind == "motor" else 1 / gear, UNITS[kind][not turns]
    return unit if factor == 1 else f"{factor:g} {unit}"


def _drive(model: mujoco.MjModel, number: int) -> tuple[bool, float] | None:
    """Whether an actuator turns rather than pulls, and its gear; None if it does not do one."""
    transmission, target = model.actuator_trntype[number], model.actuator_trnid[number, 0]
    gear, turns = model.actuator_gear[number], False
    if transmission == mujoco.mjtTrn.mjTRN_TENDON:
        first = model.tendon_adr[target]
        wraps = slice(first, first + model.tendon_num[target])
        joints = model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT
        types = model.jnt_type[model.wrap_objid[wraps][joints]]
        if (types == mujoco.mjtJoint.mjJNT_HINGE).any():
            return None  # its coefficients have a unit or none
    elif transmission in OF_JOINT and model.jnt_type[target] in SCALAR:
        turns = bool(model.jnt_type[target] == mujoco.mjtJoint.mjJNT_HINGE)
    elif transmission not in ALONG:
        ball = transmission in OF_JOINT and model.jnt_type[target] == mujoco.mjtJoint.mjJNT_BALL
        used = np.flatnonzero(gear[:3] if ball else gear)
        if len(used) != 1:
            return None
        gear, turns = gear[used], bool(ball or used[0] >= 3)
    return (turns, float(gear[0])) if gear[0] else None
