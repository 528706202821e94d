"""gymnasium's Pendulum-v1: swing up with too little torque to lift, and hold."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.gym_tasks import HANGING_MEAN, HANGING_STD, gym_pendulum_env
from torch_pmil.envs.rollouts import of_states
from torch_pmil.tasks.fitting import independent_start, simulated_parts
from torch_pmil.tasks.method import with_least_widths
from torch_pmil.tasks.task import Task

LENGTH = 1.0  # m
NOISE_STD = 0.05  # m
LEAST_WIDTHS = (1.5, 0.35, 0.35)  # rad/s, 1, 1 of a new policy's functions in [dq, sin q, cos q]
SUCCESS_DISTANCE = 0.25  # m
FINAL_SAMPLES = 6  # samples of the last 0.5 s at 10 Hz, both ends included


def gym_pendulum_space() -> StateSpace:
    """State [q, dq], q from upright, matched in the position of the tip.

    Example:
        >>> gym_pendulum_space().observe(torch.zeros(2, dtype=torch.float64))
        tensor([0., 1.], dtype=torch.float64)
    """
    match_space = MatchSpace.of_links(("q",), (LENGTH,), ("q", "dq"), names=("x", "y"))
    return StateSpace(("q", "dq"), ("rad", "rad/s"), (0,), match_space)


def distance_from_upright(states: Tensor) -> Tensor:
    """Largest distance (m) of the tip from upright over the last 0.5 s, (*batch).

    States x_0..x_T are (*batch, T + 1, 2).
    """
    tip = gym_pendulum_space().observe(states[..., -FINAL_SAMPLES:, :])
    return (tip - torch.tensor([0.0, LENGTH], dtype=states.dtype)).norm(dim=-1).amax(-1)


def gym_pendulum(demonstrations: Demonstrations | None = None) -> Task:
    """Swing up gymnasium's Pendulum-v1 and hold it, in 4 s at 10 Hz.

    It needs gymnasium. A success has the tip within 0.25 m of upright for the last 0.5 s.

    Args:
        demonstrations: positions x, y of the tip at 10 Hz; None for the package's own.
            Others raise :class:`DemonstrationError`.
    """
    env, space = gym_pendulum_env(), gym_pendulum_space()
    start = independent_start(*torch.tensor([HANGING_MEAN, HANGING_STD]).double())
    return Task(
        **simulated_parts("gym_pendulum", env, space, demonstrations, initial=start),
        make_env=gym_pendulum_env,
        noise_std=NOISE_STD,
        error=of_states(distance_from_upright),
        tolerance=SUCCESS_DISTANCE,
        method=with_least_widths(LEAST_WIDTHS, num_centres=50),
    )
