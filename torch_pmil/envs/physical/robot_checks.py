"""Checks of a robot, and of the numbers that it is given and gives."""

from __future__ import annotations

from inspect import iscoroutinefunction

import torch
from torch import Tensor

METHODS = ("read_state", "send", "stop")


def check_robot(robot: object) -> None:
    """Raise TypeError unless an object has the methods of a physical robot.

    Example:
        >>> check_robot(None)
        Traceback (most recent call last):
        TypeError: robot needs the methods read_state, send, stop, got NoneType without read_state
    """
    name = robot.__name__ if isinstance(robot, type) else type(robot).__name__
    problem = f"the class {name} itself: call it first" if isinstance(robot, type) else ""
    for method in METHODS:
        if not callable(getattr(robot, method, None)):
            problem = problem or f"{name} without {method}"
        elif iscoroutinefunction(getattr(robot, method)):
            problem = problem or f"{name} whose {method} is a coroutine, which nobody awaits"
    if problem:
        raise TypeError(f"robot needs the methods {', '.join(METHODS)}, got {problem}")


def finite_vector(name: str, values: object, length: int | None = None) -> Tensor:
    """Copy of values as a float64 vector. Raises ValueError if a value is not a finite number.

    Args:
        name: of the values, for the error.
        values: numbers (F,).
        length: F; None for any from 1 on.

    Example:
        >>> finite_vector("low", [-1, float("nan")])
        Traceback (most recent call last):
        ValueError: low must be a list of finite numbers, got [-1, nan]
    """
    try:
        if isinstance(values, Tensor | complex) and torch.as_tensor(values).is_complex():
            raise TypeError
        vector = torch.as_tensor(values, dtype=torch.float64, device="cpu").detach().clone()
    except (TypeError, ValueError, RuntimeError, OverflowError):
        vector = torch.zeros(0, dtype=torch.float64)
    wanted = vector.numel() if length is None else length
    if vector.shape != (max(wanted, 1),) or not vector.isfinite().all():
        count = "a list of" if length is None else length
        shown = values.tolist() if hasattr(values, "tolist") else values
        raise ValueError(f"{name} must be {count} finite numbers, got {shown!r:.200}")
    return vector
