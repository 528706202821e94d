"""One's own robot by the names of its observation's entries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from torch_pmil.control.action_space import ActionSpace
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv
from torch_pmil.envs.adapter import CosSin
from torch_pmil.envs.mujoco_robot import MujocoRobot
from torch_pmil.envs.one_robot import OneRobot, check_period
from torch_pmil.tasks.fitting import actions_of, independent_start
from torch_pmil.tasks.own_starts import Robot

ROUNDED = 0.011  # by which a control period may differ from the robot's: 0.033 s at 30 Hz
DEGREES = ("deg", "degree", "degrees", "°")


def entries_of(
    env: Any,
    state: Sequence[str],
    units: Sequence[str],
    angles: Sequence[str],
    settings: dict[str, Any],
) -> tuple[Sequence[str], Sequence[str], Sequence[str]]:
    """Names, units and angles of the observation; a MujocoRobot knows them, and its start."""
    if not isinstance(env, MujocoRobot):
        return state, units, angles
    if state and tuple(state) != env.names:
        raise ValueError(
            f"state must be that of the MujocoRobot, {', '.join(env.names)}, so leave it out, got "
            f"{', '.join(state)}"
        )
    settings.setdefault("initial", independent_start(env.initial_mean, env.initial_std))
    return env.names, units or env.units, angles or env.turning


def observed_entries(
    observed: Sequence[str], angles: Sequence[str], units: Sequence[str]
) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Names of the state's entries, a cosine and sine counted as one, and indices of the angles.

    Raises:
        ValueError: an angle is unknown, its unit is degrees, or its cosine or sine is missing; or
            there is another number of units.
    """
    turned = {*angles, *(observed[pair.cos][4:] for pair in _pairs(observed))}
    names = tuple(name.removeprefix("cos ") for name in observed if name[:4] != "sin ")
    if unknown := sorted(turned - set(names)):
        raise ValueError(
            f"angles must be entries of the state {', '.join(names)}, got {', '.join(unknown)}"
        )
    if len(units) not in (0, len(names)):
        raise ValueError(
            f"units must be one for each of {', '.join(names)}, got {', '.join(units)}"
        )
    for name, unit in zip(names, units, strict=False):  # there may be none
        if name in turned and unit in DEGREES:
            raise ValueError(
                f"angles must be in rad, got {name} in {unit}: convert the observation"
            )
    return names, tuple(index for index, name in enumerate(names) if name in turned)


def _pairs(observed: Sequence[str]) -> list[CosSin]:
    """The angles whose cosine and sine an observation holds."""
    names = list(observed)
    angles = dict.fromkeys(name[4:] for name in names if name[:4] in ("cos ", "sin "))
    pairs = [(f"cos {angle}", f"sin {angle}") for angle in angles]
    if missing := [name for pair in pairs for name in pair if name not in names]:
        raise ValueError(f"state must name {missing[0]} too, got {', '.join(names)}")
    return [CosSin(names.index(cos), names.index(sin)) for cos, sin in pairs]


def robot_of(
    env: Any, control_period: float, observed: Sequence[str], steps: int | None, dim: int
) -> Robot:
    """The robot of an environment whose entries are so named, with a state of ``dim`` entries.

    Raises:
        TypeError, ValueError: as :class:`~torch_pmil.envs.one_robot.OneRobot`, or the observation
            has another number of entries.
    """
    if isinstance(env, MujocoRobot):
        check_period(env.control_period, control_period, steps, ROUNDED)
        return env
    robot = OneRobot(env, control_period, _pairs(observed), steps)
    if robot.dim != dim:
        raise ValueError(
            f"state must name the {robot.dim + len(robot.angles)} entries of the observation, got "
            f"{', '.join(observed)}"
        )
    return robot


def set_evaluated(robot: Robot, settings: dict[str, Any]) -> None:
    """Measure policies from fresh starts, unless a person would have to put the robot there.

    Raises ValueError if that is asked for.
    """
    if robot.physical and settings.get("evaluated"):
        raise ValueError("evaluated must be False for a physical robot, got True")
    settings.setdefault("evaluated", not robot.physical)


def chosen_actions(settings: Mapping[str, Any], env: MujocoRobotEnv | AdaptedEnv) -> ActionSpace:
    """The actions that are given, or else those of the robot; ValueError if it has others."""
    own = actions_of(env)
    actions: ActionSpace = settings.get("actions", own)
    if len(actions.names) != len(own.names):
        raise ValueError(f"actions must be as many as the robot's, {own}, got {actions}")
    return actions
