"""The cart-pole of PILCO: swing the pole up and balance it by pushing the cart."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.cart_pole import POLE_LENGTH, CartPoleEnv
from torch_pmil.envs.rollouts import of_states
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.inverted_pendulum import cart_and_tip
from torch_pmil.tasks.method import VELOCITIES, with_least_widths
from torch_pmil.tasks.task import Task

NOISE_STD = 0.03  # m
SUCCESS_DISTANCE = 0.15  # m, a quarter of the pole
FINAL_SAMPLES = 6  # samples of the last 0.5 s at 10 Hz, both ends included
# m, m/s, rad/s, 1 and 1 of a new policy's basis functions in [x, dx, dq, sin q, cos q]
LEAST_WIDTHS = (0.3, 0.6, 1.5, 0.35, 0.35)


def cart_pole_space() -> StateSpace:
    """State [x, dx, q, dq], matched in the positions of the cart and of the tip of the pole.

    Example:
        >>> cart_pole_space().observe(torch.zeros(4, dtype=torch.float64))
        tensor([0.0000, 0.0000, 0.6000], dtype=torch.float64)
    """
    names, units = ("x", "dx", "q", "dq"), ("m", "m/s", "rad", "rad/s")
    return StateSpace(names, units, (2,), cart_and_tip(names, POLE_LENGTH))


def distance_from_goal(states: Tensor, goal: Tensor) -> Tensor:
    """Largest distance (m) of the tip from two places over the last 0.5 s, (*batch).

    They are the goal, and upright over the cart, wherever that is.

    Args:
        states: x_0..x_T, (*batch, T + 1, 4).
        goal: [x, z] of the tip, m, of the last samples or of all, (6, 2) or (2,).

    Example:
        >>> upright = torch.zeros(31, 4, dtype=torch.float64)
        >>> distance_from_goal(upright, torch.tensor([0.1, 0.6], dtype=torch.float64))
        tensor(0.1000, dtype=torch.float64)
    """
    x, x_tip, z_tip = cart_pole_space().observe(states[..., -FINAL_SAMPLES:, :]).unbind(-1)
    tip = torch.stack([x_tip, z_tip], -1)
    over_cart = torch.stack([x, torch.full_like(x, POLE_LENGTH)], -1)
    distances = torch.maximum((tip - goal).norm(dim=-1), (tip - over_cart).norm(dim=-1))
    return distances.amax(-1)


def cart_pole(demonstrations: Demonstrations | None = None) -> Task:
    """Swing the pole up as demonstrated and balance it, in 3 s at 10 Hz.

    A success has the tip within 0.15 m of the demonstrated mean, and of upright over the cart, for
    the last 0.5 s.

    Args:
        demonstrations: positions x_cart, x_tip, z_tip at 10 Hz; None for the package's own.
            Others raise :class:`DemonstrationError`.
    """
    env, space = CartPoleEnv(), cart_pole_space()
    parts = simulated_parts("cart_pole", env, space, demonstrations)
    goal = parts["demonstrations"].positions[:, -FINAL_SAMPLES:, 1:].mean(0)
    return Task(
        **parts,
        make_env=CartPoleEnv,
        noise_std=NOISE_STD,
        error=of_states(lambda states: distance_from_goal(states, goal)),
        tolerance=SUCCESS_DISTANCE,
        method=with_least_widths(LEAST_WIDTHS, model=VELOCITIES),
    )
