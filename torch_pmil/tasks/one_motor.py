"""Pendubot and acrobot: swing two links up and balance them with one motor."""

from __future__ import annotations

from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.pendubot import (
    CONTROL_PERIOD,
    LINK_LENGTHS,
    AcrobotEnv,
    PendubotEnv,
    tip_height,
)
from torch_pmil.envs.rollouts import of_states
from torch_pmil.tasks.double_pendulum import LEAST_WIDTHS, two_link_space
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.method import with_least_widths
from torch_pmil.tasks.task import Task

NOISE_STD = 0.025  # m
LINE = 0.45  # m, height of the goal region, published
FINAL_SAMPLES = round(0.5 / CONTROL_PERIOD) + 1  # of the last 0.5 s, both ends included


def one_motor_space() -> StateSpace:
    """State [q1, dq1, q2, dq2], matched in the positions of the two link ends.

    Example:
        >>> import torch
        >>> one_motor_space().observe(torch.zeros(4, dtype=torch.float64))
        tensor([0.0000, 0.2000, 0.0000, 0.5000], dtype=torch.float64)
    """
    return two_link_space(LINK_LENGTHS)


def depth_below_upright(states: Tensor) -> Tensor:
    """Largest depth (m) of the tip below its upright place over the last 0.5 s, (*batch).

    States x_0..x_T are (*batch, T + 1, 4).
    """
    return sum(LINK_LENGTHS) - tip_height(states[..., -FINAL_SAMPLES:, :]).amin(-1)


def pendubot(demonstrations: Demonstrations | None = None) -> Task:
    """Swing the pendubot up as demonstrated, in 3 s at 25 Hz.

    A success has the tip above the line of the AI Olympics, 0.45 m, for the last 0.5 s.

    Args:
        demonstrations: link positions x1, y1, x2, y2 at 25 Hz; None for the package's own.
            Others raise :class:`DemonstrationError`.
    """
    return _one_motor("pendubot", PendubotEnv, demonstrations)


def acrobot(demonstrations: Demonstrations | None = None) -> Task:
    """Swing the acrobot up as demonstrated, in 3 s at 25 Hz; all else is as in :func:`pendubot`."""
    return _one_motor("acrobot", AcrobotEnv, demonstrations)


def _one_motor(
    name: str, make_env: type[PendubotEnv], demonstrations: Demonstrations | None
) -> Task:
    env, space = make_env(), one_motor_space()
    return Task(
        **simulated_parts(name, env, space, demonstrations),
        make_env=make_env,
        noise_std=NOISE_STD,
        error=of_states(depth_below_upright),
        tolerance=sum(LINK_LENGTHS) - LINE,
        method=with_least_widths(LEAST_WIDTHS),
    )
