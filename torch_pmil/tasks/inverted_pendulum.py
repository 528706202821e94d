"""gymnasium's InvertedPendulum-v5: bring pole and cart to rest in the middle."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_pmil.control.state_space import MatchSpace, StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.gym_tasks import CART_START, inverted_pendulum_env
from torch_pmil.envs.rollouts import of_states
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.fitting import simulated_parts
from torch_pmil.tasks.method import Method, PolicySettings, RandomMotion
from torch_pmil.tasks.task import Task

POLE_LENGTH = 0.6  # m
NOISE_STD = 0.02  # m
SUCCESS_DISTANCE = 0.1  # m
FINAL_SAMPLES = 26  # samples of the last second at 25 Hz, both ends included


def inverted_pendulum_space() -> StateSpace:
    """State [x, q, dx, dq], matched in the positions of the cart and of the tip of the pole.

    The pole never turns round, so its angle is an entry like the others.

    Example:
        >>> inverted_pendulum_space().observe(torch.zeros(4, dtype=torch.float64))
        tensor([0.0000, 0.0000, 0.6000], dtype=torch.float64)
    """
    names, units = ("x", "q", "dx", "dq"), ("m", "rad", "m/s", "rad/s")
    return StateSpace(names, units, (), cart_and_tip(names, POLE_LENGTH))


def cart_and_tip(state: Sequence[str], length: float) -> MatchSpace:
    """Positions x_cart, x_tip, z_tip of a cart and of the tip of its pole.

    Args:
        state: names of its entries: ``"x"`` is the place of the cart (m), ``"q"`` the angle of the
            pole from upright (rad).
        length: of the pole, m.

    Example:
        >>> cart_and_tip(("x", "q"), 0.6)(torch.tensor([1.0, 0.0], dtype=torch.float64))
        tensor([1.0000, 1.0000, 0.6000], dtype=torch.float64)
    """
    D = len(state)
    x, pole = torch.eye(D, dtype=torch.float64)[[state.index("x"), state.index("q")]]
    # columns: state, sin and cos of the pole's angle
    positions = torch.zeros(3, D + 2, dtype=torch.float64)
    positions[:2, :D] = x
    positions[1, D] = positions[2, D + 1] = length
    return MatchSpace(("x_cart", "x_tip", "z_tip"), ("m",) * 3, pole[None], positions)


def inverted_pendulum(demonstrations: Demonstrations | None = None) -> Task:
    """Recover to upright as demonstrated, in 2 s at 25 Hz.

    It needs gymnasium. A success has the tip within 0.1 m of the demonstrated mean for the last
    second.

    Args:
        demonstrations: positions x_cart, x_tip, z_tip at 25 Hz; None for the package's own.
            Others raise :class:`DemonstrationError`.
    """
    space, env = inverted_pendulum_space(), inverted_pendulum_env()
    # mean and covariance of the uniform start
    start = Gaussian(torch.zeros(4).double(), CART_START**2 / 3 * torch.eye(4).double())
    parts = simulated_parts("inverted_pendulum", env, space, demonstrations, initial=start)
    tip = parts["demonstrations"].positions[:, -FINAL_SAMPLES:, 1:].mean(0)

    def distance_from_demonstrated(states: Tensor) -> Tensor:
        return (space.observe(states[..., -FINAL_SAMPLES:, :])[..., 1:] - tip).norm(dim=-1).amax(-1)

    return Task(
        **parts,
        make_env=inverted_pendulum_env,
        noise_std=NOISE_STD,
        error=of_states(distance_from_demonstrated),
        tolerance=SUCCESS_DISTANCE,
        method=Method(
            policy=PolicySettings(num_centres=50, input_scale=3.0),
            exploration=RandomMotion(random_action=0.1),
            # nats per step and observed entry, of which two vary: the tip's height hardly changes
            search=SearchSettings(trust_threshold=1.0),
        ),
    )
