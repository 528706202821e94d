"""Twenty-three robots on which nothing was tuned, each with recordings and what one would say.

They differ in what they are, in units, rates, noise and length of the motion. The first thirteen
may be looked at while the package is developed, the others only at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box

from reproduction.runge_kutta import runge_kutta
from torch_pmil.demonstrations import Recordings

Array = np.ndarray
Derivative = Callable[[Array, Array], Sequence[float] | Array]


@dataclass(frozen=True)
class Stranger:
    """A robot given by the derivative of its state, and what is shown to it.

    Args:
        state: names of the observed entries, the first ones of the state.
        derivative: of the state at a state and an action.
        dt: control period, s.
        duration: of the motion, s.
        limits: largest actions; with ``one_sided`` the smallest are 0.
        start: mean of the state at a reset; ``spread`` is its standard deviation.
        goal: of the shown entries by name, reached smoothly; or a function of time in 0..1.
        noise: standard deviations of the readings.
        delay: control periods before an action takes effect.
        said: further arguments of PMIL.
    """

    state: tuple[str, ...]
    derivative: Derivative
    dt: float
    duration: float
    limits: tuple[float, ...]
    start: tuple[float, ...]
    spread: tuple[float, ...]
    goal: dict[str, float | Callable[[Array], Array]]
    noise: tuple[float, ...] = (0.0,)
    delay: int = 0
    one_sided: bool = False
    said: dict[str, Any] = field(default_factory=dict)

    def robot(self) -> StrangerEnv:
        """The robot."""
        return StrangerEnv(self)

    def recordings(self, seed: int = 0) -> Recordings:
        """Four recordings at 50 samples a motion and more, each a little larger or slower."""
        random, count = np.random.default_rng(seed), max(101, round(self.duration / self.dt) + 1)
        times = np.linspace(0, self.duration, count)
        values = []
        for _ in range(4):
            share = np.clip(times / (self.duration * random.uniform(0.72, 0.8)), 0, 1)
            smooth = share**3 * (10 - 15 * share + 6 * share**2)
            size, columns = random.uniform(0.96, 1.04), []
            for name, goal in self.goal.items():
                begin = self.start[self.state.index(name)]
                way = goal(smooth) if callable(goal) else smooth * (goal - begin)
                columns.append(begin + size * way)
            clean = np.stack(columns, -1)
            values.append(clean + 0.003 * np.ptp(clean, 0) * random.standard_normal(clean.shape))
        names, shown = tuple("1234"), tuple(torch.from_numpy(each) for each in values)
        clock = torch.from_numpy(times)
        return Recordings(names, (clock,) * 4, shown, tuple(self.goal), in_seconds=True)


class StrangerEnv(gymnasium.Env):
    """A stranger as an environment, integrated by Runge-Kutta."""

    metadata = {"render_modes": []}

    def __init__(self, stranger: Stranger) -> None:
        self.stranger, self.dt = stranger, stranger.dt
        high = np.array(stranger.limits, np.float64)
        low = np.zeros_like(high) if stranger.one_sided else -high
        self.observation_space = Box(-np.inf, np.inf, (len(stranger.state),), np.float64)
        self.action_space = Box(low, high, dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Array, dict]:
        super().reset(seed=seed)
        random = self.np_random.standard_normal(len(self.stranger.start))
        self.true = np.array(self.stranger.start) + np.array(self.stranger.spread) * random
        middle = (self.action_space.low + self.action_space.high) / 2
        self.waiting = [middle] * self.stranger.delay
        return self._reading(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict]:
        limited = np.clip(action, self.action_space.low, self.action_space.high)
        self.waiting.append(limited)
        u, steps = self.waiting.pop(0), max(2, round(self.dt / 0.01)) if self.dt < 1 else 10
        h, f = self.dt / steps, lambda x: np.asarray(self.stranger.derivative(x, u), np.float64)
        for _ in range(steps):
            self.true = runge_kutta(f, self.true, h)
        return self._reading(), 0.0, False, False, {}

    def _reading(self) -> Array:
        clean = self.true[: len(self.stranger.state)]
        return clean + np.array(self.stranger.noise) * self.np_random.standard_normal(len(clean))


def joint(inertia: float, weight: float, friction: float, static: float = 0.0) -> Derivative:
    def derivative(x: Array, u: Array) -> Sequence[float]:
        q, dq = x[:2]
        drag = friction * dq + static * np.tanh(dq / 0.02)
        return dq, (u[0] - weight * np.sin(q) - drag) / inertia

    return derivative


def mass(mass: float, drag: float, unit: float = 1.0) -> Derivative:
    return lambda x, u: (x[1], unit * u[0] / mass - drag / mass * x[1])


def _servo(rate: float, damping: float) -> Derivative:
    return lambda x, u: (x[1], rate**2 * (u[0] - x[0]) - 2 * damping * rate * x[1])


def _base(x: Array, u: Array) -> Sequence[float]:
    speed, turn = 0.04 * (u[0] + u[1]) / 2, 0.04 * (u[1] - u[0]) / 0.25
    return speed * np.cos(x[2]), speed * np.sin(x[2]), turn


def _crane(x: Array, u: Array) -> Sequence[float]:
    _, q, dx, dq = x
    a = (u[0] - 2 * dx + 0.3 * np.sin(q) * (0.5 * dq**2 + 9.81 * np.cos(q))) / (
        1 + 0.3 * np.sin(q) ** 2
    )
    return dx, dq, a, (-a * np.cos(q) - 9.81 * np.sin(q)) / 0.5 - 0.1 * dq


def _quadrotor(x: Array, u: Array) -> Sequence[float]:
    _, _, tilt, vx, vz, turn = x
    thrust = 9.81 * (1 + (u[0] + u[1]) / 2)
    return vx, vz, turn, -thrust * np.sin(tilt), thrust * np.cos(tilt) - 9.81, 12 * (u[1] - u[0])


def _arm(lengths: float, mass: float, friction: float) -> Derivative:
    def derivative(x: Array, u: Array) -> Sequence[float]:
        q1, q2, d1, d2 = x
        c, inertia = lengths / 2, mass * lengths**2 / 12
        h = mass * lengths * c
        a11 = 2 * inertia + mass * (c**2 + lengths**2 + c**2) + 2 * h * np.cos(q2)
        a12, a22 = inertia + mass * c**2 + h * np.cos(q2), inertia + mass * c**2
        s = h * np.sin(q2)
        g = 9.81 * mass
        b1 = u[0] + s * (2 * d1 * d2 + d2**2) - g * (c + lengths) * np.sin(q1)
        b1 -= g * c * np.sin(q1 + q2) + friction * d1
        b2 = u[1] - s * d1**2 - g * c * np.sin(q1 + q2) - friction * d2
        det = a11 * a22 - a12**2
        return d1, d2, (a22 * b1 - a12 * b2) / det, (a11 * b2 - a12 * b1) / det

    return derivative


def _spring(x: Array, u: Array) -> Sequence[float]:
    q, p, dq, dp = x
    t = 90 * (p - q) + 0.6 * (dp - dq)
    return dq, dp, (t - 0.2 * dq) / 0.5, (u[0] - t - 0.5 * dp) / 0.2


def _rooms(x: Array, u: Array) -> Sequence[float]:
    near, far = x
    return (
        0.0010 * u[0] - 0.0006 * (near - far) - 0.0002 * (near - 15),
        0.0006 * (near - far) - 0.0003 * (far - 15),
    )


def _boat(x: Array, u: Array) -> Sequence[float]:
    _, _, course, speed, turn = x
    surge, torque = u[0] + u[1], 0.4 * (u[1] - u[0])
    return (
        speed * np.cos(course),
        speed * np.sin(course),
        turn,
        (surge - 1.2 * speed) / 2,
        torque / 0.6 - 1.5 * turn,
    )


def _drone(x: Array, u: Array) -> Sequence[float]:
    _, _, tilt, vx, vz, turn = x
    thrust = 9.81 * (1 + (u[0] + u[1]) / 2)
    ax, az = -thrust * np.sin(tilt) - 0.3 * vx, thrust * np.cos(tilt) - 9.81 - 0.3 * vz
    return vx, vz, turn, ax, az, 20 * (u[1] - u[0]) - turn


def _piston(x: Array, u: Array) -> Sequence[float]:
    _, speed, pressure = x
    return speed, (20 * pressure - 4 * speed - 6 * x[0] - 2) / 1.5, (u[0] - u[1] - pressure) / 0.08


def _three_joints(x: Array, u: Array) -> Array:
    q, dq = x[:3], x[3:]
    tilt, bend = np.sin(np.cumsum(q)), np.cos(q[1])
    weight = np.array([6 * tilt[0] + 3 * tilt[1], 3 * tilt[1] + tilt[2], tilt[2]])
    inertia = np.diag([0.6, 0.3, 0.1]) + 0.1
    inertia[:2, :2] += 0.05 * bend * np.array([[2, 1], [1, 0]])
    return np.concatenate([dq, np.linalg.solve(inertia, u - weight - 0.5 * dq)])


def _lagging_rail(x: Array, u: Array) -> Sequence[float]:
    return x[1], x[2] - 0.5 * x[1], (u[0] - x[2]) / 0.12


ANGLE, JOINT = {"angles": ("q",)}, ("q", "dq")
STRANGERS = {
    "rail": Stranger(("x", "dx"), mass(2, 1), 0.05, 2.0, (8.0,), (0, 0), (0.01,) * 2, {"x": 0.5}),
    "rail_mm": Stranger(
        *(("x", "dx"), mass(2, 1, 1000), 0.05, 2.0, (8.0,), (0, 0), (10, 10), {"x": 500.0}),
        noise=(2.0, 10.0),
    ),
    "rubbing_joint": Stranger(
        *(JOINT, joint(0.4, 2, 0.2, 0.8), 0.05, 2.5, (6.0,), (0, 0), (0.03, 0.03), {"q": 1.2}),
    ),
    "late_joint": Stranger(
        *(JOINT, joint(0.5, 3, 0.4), 0.05, 3.0, (6.0,), (0, 0), (0.03, 0.03), {"q": 1.0}),
        noise=(0.01, 0.05),
        delay=2,
    ),
    "wheel": Stranger(
        *(("q",), lambda x, u: (u[0],), 0.02, 3.0, (3.0,), (0,), (0.03,), {"q": 2.5}),
        noise=(0.01,),
    ),
    "base_arc": Stranger(
        *(("x", "y", "th"), _base, 0.1, 6.0, (14.0, 14.0), (0, 0, 0), (0.02, 0.02, 0.03)),
        {"x": lambda s: np.sin(1.4 * s), "y": lambda s: 1 - np.cos(1.4 * s), "th": 1.4},
        noise=(0.01, 0.01, 0.01),
        said={"angles": ("th",)},
    ),
    "servo": Stranger(
        *(JOINT, _servo(9, 0.7), 0.04, 2.0, (2.5,), (0, 0), (0.03, 0.03), {"q": 1.4}),
        noise=(0.005, 0.05),
    ),
    "crane": Stranger(
        *(("x", "q", "dx", "dq"), _crane, 0.05, 4.0, (6.0,), (0,) * 4, (0.01,) * 4, {"x": 1.0}),
        noise=(0.002, 0.005, 0.01, 0.02),
    ),
    "lifting_arm": Stranger(
        *(("q1", "q2", "dq1", "dq2"), _arm(0.35, 0.6, 0.1), 0.02, 2.0, (6.0, 3.0), (0,) * 4),
        *((0.03,) * 4, {"q1": 0.9, "q2": 0.6}),
        noise=(0.002, 0.002, 0.02, 0.02),
    ),
    "rooms": Stranger(
        *(("near", "far"), _rooms, 120.0, 7200.0, (10.0,), (18.0, 17.0), (0.3, 0.3)),
        {"near": 23.0, "far": 20.0},
        noise=(0.05, 0.05),
        one_sided=True,
    ),
    "piston": Stranger(
        *(("z", "dz"), _piston, 0.04, 2.5, (2.0, 2.0), (0, 0, 0.1), (0.02, 0.02, 0), {"z": 0.5}),
        noise=(0.003, 0.02),
        one_sided=True,
    ),
    "three_joints": Stranger(
        *(("q1", "q2", "q3"), _three_joints, 0.05, 2.5, (18.0, 10.0, 4.0), (0,) * 6, (0.02,) * 6),
        {"q1": 0.8, "q2": -0.6, "q3": 0.5},
        noise=(0.004,) * 3,
    ),
    "drone": Stranger(
        *(("x", "z", "tilt", "dx", "dz", "dtilt"), _drone, 0.02, 4.0, (0.5, 0.5), (0,) * 6),
        *((0.02,) * 6, {"x": 1.5, "z": 0.8}),
        noise=(0.005,) * 6,
    ),
    # looked at only at the end
    "half_turn": Stranger(
        *(JOINT, joint(0.3, 2, 0.2), 0.05, 3.0, (5.0,), (0, 0), (0.05, 0.05), {"q": 3.1416}),
        said=ANGLE,
    ),
    "fast_joint": Stranger(
        *(JOINT, joint(0.05, 0.5, 0.05), 0.01, 1.0, (2.0,), (0, 0), (0.03, 0.1), {"q": 1.0}),
        noise=(0.002, 0.05),
    ),
    "slow_reach": Stranger(
        *(JOINT, joint(0.8, 3, 0.8), 0.1, 12.0, (6.0,), (0, 0), (0.03, 0.03), {"q": 1.2}),
        noise=(0.005, 0.02),
    ),
    "spring": Stranger(
        *(("q", "p", "dq", "dp"), _spring, 0.05, 3.0, (6.0,), (0,) * 4, (0.02,) * 4, {"q": 1.0}),
        noise=(0.005, 0.005, 0.03, 0.03),
    ),
    "boat": Stranger(
        *(("x", "y", "c", "v", "w"), _boat, 0.1, 10.0, (2.0, 2.0), (0,) * 5, (0.03,) * 5),
        {"x": lambda s: 3 * s, "y": lambda s: 0.6 * np.sin(np.pi * s / 2) ** 2},
        noise=(0.02, 0.02, 0.01, 0.02, 0.02),
    ),
    "quadrotor": Stranger(
        *(("x", "z", "tilt", "dx", "dz", "dtilt"), _quadrotor, 0.05, 2.5, (0.6, 0.6), (0,) * 6),
        *((0.02,) * 6, {"x": 0.6, "z": 0.5}),
    ),
    "lagging_rail": Stranger(
        *(("x", "dx"), _lagging_rail, 0.04, 2.4, (3.0,), (0, 0, 0), (0.01, 0.01, 0), {"x": 0.6}),
        noise=(0.003, 0.02),
    ),
    "degrees": Stranger(
        *(JOINT, lambda x, u: (x[1], 57.3 * (u[0] - 2 * np.sin(x[0] / 57.3)) / 0.3 - 0.5 * x[1])),
        *(0.05, 2.5, (5.0,), (0, 0), (2.0, 2.0), {"q": 70.0}),
        noise=(0.5, 2.0),
    ),
    "thruster": Stranger(
        *(("z", "dz"), lambda x, u: (x[1], 9.81 * (u[0] - 1) - 0.3 * x[1]), 0.02, 2.5, (2.0,)),
        *((0, 0), (0.02, 0.02), {"z": 0.8}),
        one_sided=True,
    ),
    "two_joints": Stranger(
        *(("q1", "q2", "dq1", "dq2"), _arm(0.5, 1.0, 0.5), 0.05, 3.0, (20.0, 8.0), (0,) * 4),
        *((0.03,) * 4, {"q1": 0.7, "q2": -0.9}),
        noise=(0.005, 0.005, 0.03, 0.03),
    ),
}
