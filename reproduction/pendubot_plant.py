"""The equations of motion of the AI Olympics' double pendulum, of many plants at once.

Its robustness score varies the plant to where no rigid link is: inertias below what mass and centre
of mass need, negative friction. So the published equations are integrated here, not a simulator's
bodies. Angles are those of :class:`PendubotEnv`, the first from upright.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from reproduction.runge_kutta import runge_kutta

GRAVITY = 9.81  # m/s²
LENGTH = 0.2  # m, of link 1
GEAR_RATIO = 6.0
FRICTION_SLOPE = 100.0  # s/rad, of the smoothed sign of a velocity in Coulomb friction
TIME_STEP = 0.002  # s
STEPS = 5000  # 10 s


@dataclass(frozen=True)
class Plant:
    """Published parameters of the plant, that the robustness score varies, one at a time.

    Args:
        Ir: inertia of the motors, kg m².
        m1r1, m2r2: masses times centres of mass, kg m.
        I1, I2: inertias about the joints, kg m².
        m2: mass of link 2, kg.
        b1, b2: viscous friction of the joints, N·m·s/rad.
        cf1, cf2: Coulomb friction of the joints, N·m.
    """

    Ir: float = 0.0
    m1r1: float = 0.5234602302310271 * 0.2
    I1: float = 0.031887199591513114
    b1: float = 0.0
    cf1: float = 0.0
    m2r2: float = 0.6255677234174437 * 0.25569305436052964
    m2: float = 0.6255677234174437
    I2: float = 0.05086984812807257
    b2: float = 0.0
    cf2: float = 0.0


def accelerations(plants: dict[str, Tensor], states: Tensor, torques: Tensor) -> Tensor:
    """Angular accelerations (N, 2), rad/s², of N plants in states under torques.

    Args:
        plants: the entries of :class:`Plant`, (N,) each.
        states: [q1, dq1, q2, dq2], (N, 4), rad and rad/s.
        torques: of the two joints, (N, 2), N·m.
    """
    p = plants
    q1, dq1, q2, dq2 = states.unbind(-1)
    coupled = LENGTH * p["m2r2"] * q2.cos()
    m11 = p["I1"] + p["I2"] + LENGTH**2 * p["m2"] + 2 * coupled + (GEAR_RATIO**2 + 1) * p["Ir"]
    m12 = p["I2"] + coupled - GEAR_RATIO * p["Ir"]
    m22 = p["I2"] + GEAR_RATIO**2 * p["Ir"]
    whirl = LENGTH * p["m2r2"] * q2.sin()
    pull2 = GRAVITY * p["m2r2"] * (q1 + q2).sin()
    pull1 = GRAVITY * (p["m1r1"] + LENGTH * p["m2"]) * q1.sin() + pull2
    f1 = torques[:, 0] + pull1 + whirl * dq2 * (2 * dq1 + dq2) - friction(p["b1"], p["cf1"], dq1)
    f2 = torques[:, 1] + pull2 - whirl * dq1**2 - friction(p["b2"], p["cf2"], dq2)
    determinant = m11 * m22 - m12**2
    return torch.stack([m22 * f1 - m12 * f2, m11 * f2 - m12 * f1], -1) / determinant[:, None]


def friction(viscous: Tensor, coulomb: Tensor, velocities: Tensor) -> Tensor:
    """Torques (N,) against the velocities (N,), N·m."""
    return viscous * velocities + coulomb * (FRICTION_SLOPE * velocities).atan()


def stepped(plants: dict[str, Tensor], states: Tensor, torques: Tensor) -> Tensor:
    """States (N, 4) one time step of 2 ms later, by Runge-Kutta of fourth order."""

    def slope(at: Tensor) -> Tensor:
        bent = accelerations(plants, at, torques)
        return torch.stack([at[:, 1], bent[:, 0], at[:, 3], bent[:, 1]], -1)

    return runge_kutta(slope, states, TIME_STEP)


def stacked(plants: list[Plant]) -> dict[str, Tensor]:
    """The entries of N plants, (N,) each."""
    return {
        entry.name: torch.tensor([getattr(plant, entry.name) for plant in plants]).double()
        for entry in fields(Plant)
    }


def simulated(
    plants: dict[str, Tensor], start: Tensor, torques: Callable[[int, Tensor], Tensor]
) -> Tensor:
    """States (STEPS + 1, N, 4) of N plants from a start (4,).

    Args:
        plants: as for :func:`accelerations`.
        start: state, the same of all.
        torques: torques (N, 2) of a time step, from its number and the states so far,
            (number + 1, N, 4).
    """
    states = start.expand(STEPS + 1, len(plants["m2"]), 4).clone()
    for step in range(STEPS):
        applied = torques(step, states[: step + 1])
        states[step + 1] = stepped(plants, states[step], applied)
    return states
