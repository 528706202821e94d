"""A small robot of one entry, learned once for the tests of searches."""

from __future__ import annotations

import torch

from tests.helpers.draws import Draws
from torch_pmil.model.dynamics import GPDynamics


def damped_integrator() -> GPDynamics:
    """The model of a damped integrator, learned from 30 random transitions."""
    draws = Draws(seed=0)
    x, u = draws.uniform(-1.5, 1.5, 30, 1), draws.uniform(-2, 2, 30, 1)
    dynamics = GPDynamics(2, 1)
    dynamics.fit(torch.cat([x, u], -1), 0.2 * (u - 0.5 * x) + 0.01 * draws.normal(30, 1))
    return dynamics
