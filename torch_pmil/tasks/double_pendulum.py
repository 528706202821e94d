"""Section 5.1: swing up and balance the double pendulum, from five demonstrations."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.double_pendulum import LINK_LENGTH, DoublePendulumEnv
from torch_pmil.envs.rollouts import of_states
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.method import ON_SAMPLES, VELOCITIES, with_least_widths
from torch_pmil.tasks.task import Task

NOISE_STD = 0.05  # m
SUCCESS_DISTANCE = 0.25  # m
REACH_DISTANCE = 0.1  # m, of the tip that reaches a target
FINAL_SAMPLES = 6  # samples of the last 0.5 s at 10 Hz, both ends included
# rad/s, 1 and 1 of a new policy's basis functions in [dq1, dq2, sin q1, sin q2, cos q1, cos q2]
LEAST_WIDTHS = (1.5, 1.5, 0.35, 0.35, 0.35, 0.35)
UPRIGHT = (0.0, LINK_LENGTH, 0.0, 2 * LINK_LENGTH)  # m, of the link ends x1, y1, x2, y2


def double_pendulum_space() -> StateSpace:
    """State [q1, dq1, q2, dq2], matched in the positions of the two link ends.

    Example:
        >>> double_pendulum_space().observe(torch.zeros(4, dtype=torch.float64))
        tensor([0.0000, 0.5000, 0.0000, 1.0000], dtype=torch.float64)
    """
    return two_link_space((LINK_LENGTH, LINK_LENGTH))


def two_link_space(lengths: Sequence[float]) -> StateSpace:
    """State [q1, dq1, q2, dq2], matched in the ends of links of these lengths (m)."""
    names = ("q1", "dq1", "q2", "dq2")
    match_space = MatchSpace.of_links(("q1", "q2"), lengths, names)
    return StateSpace(names, ("rad", "rad/s", "rad", "rad/s"), (0, 2), match_space)


def joints_of(positions: Tensor) -> Tensor:
    """Base, elbow and tip (*batch, 3, 2), m, of link positions (*batch, 4)."""
    ends = positions.unflatten(-1, (2, 2))
    return torch.cat([torch.zeros_like(ends[..., :1, :]), ends], -2)


def joints_at(states: Tensor) -> Tensor:
    """Base, elbow and tip (*batch, 3, 2), m, at states (*batch, 4).

    Example:
        >>> joints_at(torch.zeros(4, dtype=torch.float64)).tolist()
        [[0.0, 0.0], [0.0, 0.5], [0.0, 1.0]]
    """
    return joints_of(double_pendulum_space().observe(states))


def distance_from_upright(states: Tensor) -> Tensor:
    """Largest distance (m) of [x1, y1, x2, y2] from upright over the last 0.5 s, (*batch).

    States x_0..x_T are (*batch, T + 1, 4).
    """
    upright = torch.tensor(UPRIGHT, dtype=states.dtype)
    positions = double_pendulum_space().observe(states[..., -FINAL_SAMPLES:, :])
    return (positions - upright).norm(dim=-1).amax(-1)


def distance_from_target(states: Tensor, targets: Tensor) -> Tensor:
    """Largest distance (m) of the tip from its target over the last 0.5 s, (*batch).

    Args:
        states: x_0..x_T, (*batch, T + 1, 4).
        targets: [x, y] of the tip, m, (*batch, 2); batches broadcast.

    Example:
        >>> upright = torch.zeros(26, 4, dtype=torch.float64)
        >>> distance_from_target(upright, torch.tensor([0.0, 0.9], dtype=torch.float64))
        tensor(0.1000, dtype=torch.float64)
    """
    tips = double_pendulum_space().observe(states[..., -FINAL_SAMPLES:, :])[..., 2:]
    return (tips - targets[..., None, :]).norm(dim=-1).amax(-1)


def double_pendulum(demonstrations: Demonstrations | None = None) -> Task:
    """The experiment of Section 5.1: 100 basis functions, 812 policy parameters, 2.5 s at 10 Hz.

    Args:
        demonstrations: link positions x1, y1, x2, y2 at 10 Hz; None for the package's own.
            Others raise :class:`DemonstrationError`.
    """
    env, space = DoublePendulumEnv(), double_pendulum_space()
    parts = simulated_parts("double_pendulum", env, space, demonstrations)
    return Task(
        **parts,
        make_env=DoublePendulumEnv,
        noise_std=NOISE_STD,
        error=of_states(distance_from_upright),
        tolerance=SUCCESS_DISTANCE,
        method=with_least_widths(LEAST_WIDTHS, model=VELOCITIES, search=ON_SAMPLES),
        sketch=joints_at,
    )
