"""Checks of what is said of one's own robot, before anything is read or moved."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from numbers import Real
from typing import Any

import numpy as np
from torch import Tensor

from torch_pmil.checks import check_names, check_text, did_you_mean
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.state_space import MatchSpace
from torch_pmil.files import short
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.tasks.method import Method
from torch_pmil.tasks.task import Task

# fields that follow from the arguments
FIXED = {"make_env", "space", "demonstrations", "history", "held", "samplings", "steps"}
OF_TEACHERS = {"noise_std", "demonstrated_states"}  # what a task with a cost has no use for
KINDS: dict[str, type] = {
    "initial": Gaussian,
    "actions": ActionSpace,
    "method": Method,
    "box": Mapping,
    "demonstrated_states": Tensor,
    "held_states": Tensor,
    "plane": Tensor,
}


def check_said(
    function: Callable[..., Any],
    kind: type[Task],
    *,
    state: object,
    units: object,
    angles: object,
    match: object,
    **settings: object,
) -> None:
    """Check the arguments of a function that makes a task of this kind for one's own robot.

    Raises:
        TypeError, ValueError: one is of another kind, a setting is unknown, or an error comes
            without its tolerance.
    """
    check_names("state", state)
    check_names("angles", angles)
    if isinstance(units, str) or not isinstance(units, Collection):
        raise TypeError(f"units must be a sequence, one for each entry, got {short(units)}")
    for unit in units:
        check_text("each of units", unit, empty=True)
    if not (match is None or isinstance(match, MatchSpace | str)):
        raise TypeError(
            f"match must be a MatchSpace or the name of a site, got {type(match).__name__}"
        )
    for name, wanted in KINDS.items():
        if settings.get(name) is not None and not isinstance(settings[name], wanted):
            got = type(settings[name]).__name__
            raise TypeError(f"{name} must be of type {wanted.__name__}, got {got}")
    _check_known(function, kind, settings)
    _check_tolerance(settings)


def seconds(value: object) -> float:
    """A control period as a float.

    Raises:
        TypeError: it is not a number.
        ValueError: it is not positive and finite.

    Example:
        >>> seconds(np.float32(0.5))
        0.5
    """
    if isinstance(value, np.ndarray | Tensor) and value.ndim == 0:
        value = value.item()
    if not isinstance(value, Real) or isinstance(value, bool):
        raise TypeError(f"control_period must be a number, in seconds, got {short(value)}")
    period = float(value)
    if not 0 < period < math.inf:
        raise ValueError(f"control_period must be positive and finite, in seconds, got {period}")
    return period


def _check_tolerance(settings: Mapping[str, object]) -> None:
    """Raise ValueError if an error of one's own would be judged by a tolerance in another unit."""
    tolerance = settings.get("tolerance")
    unknown = tolerance is None or isinstance(tolerance, Mapping)
    if settings.get("error") is not None and unknown:
        raise ValueError(
            "tolerance must be given with an error of your own, one number in its unit, got "
            f"{short(tolerance)}"
        )


def _check_known(
    function: Callable[..., Any], kind: type[Task], settings: Mapping[str, object]
) -> None:
    """Raise ValueError unless all names are fields of a task or settings of its method."""
    chosen: Any = settings.get("method") or Method()
    own = [name for name in inspect.signature(function).parameters if name != "settings"]
    fixed = FIXED if kind is Task else FIXED | OF_TEACHERS
    of_task = {entry.name for entry in fields(kind)} - fixed - set(own)
    known = {*of_task, *chosen.adjustable, *chosen.groups()}
    for name in settings:
        if name not in known:
            more = f"there are {', '.join(own)}, and more"
            hint = did_you_mean(name, [*own, *sorted(known)], more)
            raise ValueError(f"settings must be known ones, got {short(name)}: {hint}")
