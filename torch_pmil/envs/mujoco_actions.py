"""Which actuators of a MuJoCo model are actions, by which names, and what the others do."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from torch_pmil.envs.actuators import OF_JOINT, actuator_kinds
from torch_pmil.envs.robot import Array

DEGREES = 10.0  # times the reach of a joint in rad: a target beyond is one in degrees
TARGETS = {
    OF_JOINT[0]: "joint",
    int(mujoco.mjtTrn.mjTRN_TENDON): "tendon",
    int(mujoco.mjtTrn.mjTRN_SITE): "site",
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): "site",
    int(mujoco.mjtTrn.mjTRN_BODY): "body",
}
Chosen = Sequence[str] | Mapping[str, tuple[float, float]] | None


def choose_actuators(model: mujoco.MjModel, actions: Chosen) -> dict[str, int]:
    """The actuators that are actions: their numbers by action name, in the model's order.

    Ranges given in ``actions`` are written into the model. A position servo with gear 1 takes the
    name of its joint. An unnamed actuator is named after its kind and what it moves, such as
    "motor of hip".

    Raises:
        ValueError: there is no such actuator, or an action has no range.
    """
    if not model.nu:
        raise ValueError(_without_actuators(model))
    own = [model.actuator(number).name for number in range(model.nu)]
    names = list(own) if actions is None else list(actions)
    if not names:
        raise ValueError(f"actions must be at least one of {', '.join(_known(model))}, got none")
    numbers = list(range(model.nu))
    if actions is not None:
        numbers = [_number(model, name) for name in names]
        if twice := [name for name, n in Counter(numbers).items() if n > 1]:
            raise ValueError(f"actions must be different actuators, got {own[twice[0]]} twice")
    if isinstance(actions, Mapping):
        for name, number in zip(names, numbers, strict=True):
            model.actuator_ctrlrange[number] = _range(name, actions[name])
            model.actuator_ctrllimited[number] = True
    numbers = sorted(numbers)
    _check_ranges(model, numbers)
    return dict(zip(_action_names(model, numbers), numbers, strict=True))


def hold_others(model: mujoco.MjModel, chosen: Sequence[int], controls: Array) -> None:
    """Keep the actuators that are not actions at these controls (nu,).

    Those that move the same joint as an action are switched off: they are other ways to drive it.
    """
    for number in set(range(model.nu)) - set(chosen):
        model.actuator_ctrllimited[number] = True
        model.actuator_ctrlrange[number] = controls[number]
        if any(_moved(model, number) == _moved(model, other) for other in chosen):
            model.actuator_gaintype[number] = mujoco.mjtGain.mjGAIN_FIXED
            model.actuator_biastype[number] = mujoco.mjtBias.mjBIAS_NONE
            model.actuator_gainprm[number] = 0.0


def moved_joint(model: mujoco.MjModel, number: int) -> str | None:
    """Name of the joint that an actuator moves; None if it moves something else."""
    return moved_name(model, number) if _moved(model, number)[0] == OF_JOINT[0] else None


def moved_name(model: mujoco.MjModel, number: int) -> str:
    """Name of the joint, tendon, site or body that an actuator moves, "" without one."""
    kind, target = _moved(model, number)
    return getattr(model, TARGETS[kind])(target).name if kind in TARGETS else ""


def _moved(model: mujoco.MjModel, number: int) -> tuple[int, int]:
    kind = int(model.actuator_trntype[number])
    return OF_JOINT[0] if kind in OF_JOINT else kind, int(model.actuator_trnid[number, 0])


def _known(model: mujoco.MjModel) -> list[str]:
    names = range(model.nu)
    return [model.actuator(n).name or moved_name(model, n) or f"({n}, unnamed)" for n in names]


def _number(model: mujoco.MjModel, name: str) -> int:
    """The actuator of this name, or the only one of the joint or tendon of this name."""
    own = [n for n in range(model.nu) if name and model.actuator(n).name == name]
    found = own or [n for n in range(model.nu) if name and moved_name(model, n) == name]
    if len(found) == 1:
        return found[0]
    known = ", ".join(_known(model))
    if found:
        raise ValueError(f"actions must each be one actuator, got {name} for {len(found)}: {known}")
    raise ValueError(f"actions must be actuators among {known}, got {name}")


def _range(name: str, given: tuple[float, float]) -> Array:
    limits = np.asarray(given, dtype=np.float64)
    if limits.shape != (2,) or not np.isfinite(limits).all() or not limits[0] < limits[1]:
        raise ValueError(f"actions[{name!r}] must be a lowest and a highest action, got {given}")
    return limits


def _check_ranges(model: mujoco.MjModel, numbers: Sequence[int]) -> None:
    kinds = actuator_kinds(model)
    for number in numbers:
        name = model.actuator(number).name or moved_name(model, number) or str(number)
        if not model.actuator_ctrllimited[number]:
            if model.actuator_dyntype[number] == mujoco.mjtDyn.mjDYN_MUSCLE:
                model.actuator_ctrllimited[number] = True  # a muscle clips its excitation itself
                model.actuator_ctrlrange[number] = 0.0, 1.0
                continue
            raise ValueError(
                f"actuator {name} must have a ctrlrange, or inheritrange, that bounds its actions, "
                f"got none: give one in the file, or actions={{{name!r}: (low, high)}}"
            )
        if kinds[number] == "position":
            _warn_of_degrees(model, number, name)


def _warn_of_degrees(model: mujoco.MjModel, number: int, name: str) -> None:
    kind, target = _moved(model, number)
    if kind != OF_JOINT[0] or model.jnt_type[target] != mujoco.mjtJoint.mjJNT_HINGE:
        return
    limited, gear = model.jnt_limited[target], abs(model.actuator_gear[number, 0])
    reach = np.abs(model.jnt_range[target]).max() if limited else np.pi / 2
    low, high = model.actuator_ctrlrange[number]
    if max(-low, high) > DEGREES * reach * gear:
        warnings.warn(
            f"the range of actuator {name} is in rad, which MuJoCo never converts, but {low:g} to "
            f"{high:g} looks like degrees: give it in rad, by ctrlrange or actions=",
            RuntimeWarning,
            stacklevel=5,
        )


def _action_names(model: mujoco.MjModel, numbers: Sequence[int]) -> list[str]:
    kinds, named = actuator_kinds(model), list[tuple[str, str]]()
    for number in numbers:
        own, moved = model.actuator(number).name, moved_name(model, number)
        by_joint = _moved(model, number)[0] == OF_JOINT[0] and kinds[number] == "position"
        own = own or (f"{kinds[number]} of {moved}" if moved else "")
        servo = by_joint and model.actuator_gear[number, 0] == 1
        named.append((moved if servo and moved else own or str(number), own or str(number)))
    counts = Counter(name for pair in named for name in set(pair))
    names = [wanted if counts[wanted] == 1 else own for wanted, own in named]
    counts = Counter(names)
    pairs = zip(names, numbers, strict=True)
    return [name if counts[name] == 1 else f"{name} {number}" for name, number in pairs]


def _without_actuators(model: mujoco.MjModel) -> str:
    joint = next((model.joint(n) for n in range(model.njnt) if model.joint(n).name), None)
    line = ""
    if joint is not None:
        force = model.jnt_actfrcrange[joint.id, 1] or 10.0
        line = f', such as <motor joint="{joint.name}" ctrlrange="{-force:g} {force:g}"/>'
    return (
        "the model must have actuators, got none, as in a URDF: save it as MJCF "
        f"(MjSpec.to_xml) and add <actuator> with a line for each action{line}"
    )
