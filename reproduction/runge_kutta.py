"""The step of classical Runge-Kutta, by which simulated robots here are integrated."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from torch import Tensor

State = TypeVar("State", np.ndarray, Tensor)


def runge_kutta(slope: Callable[[State], State], state: State, h: float) -> State:
    """The state a time h later, of fourth order.

    Example:
        >>> round(runge_kutta(lambda x: -x, np.ones(1), 0.1).item(), 6)
        0.904837
    """
    k1 = slope(state)
    k2 = slope(state + h / 2 * k1)
    k3 = slope(state + h / 2 * k2)
    k4 = slope(state + h * k3)
    return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
