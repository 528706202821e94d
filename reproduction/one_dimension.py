"""A Gaussian process of one input and one output, which explains the method (Figures 2 and 4)."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian, Moments
from torch_pmil.gp.moment_matching import moment_match
from torch_pmil.model.dynamics import GPDynamics

NOISE_STD = 0.05
TEST_INPUT = 4.0  # far from all data
BELIEF = Gaussian(torch.tensor([-0.6]).double(), torch.tensor([[0.7**2]]).double())
SAMPLES = 200_000


def fitted_gp() -> GPDynamics:
    """The model of the robot's dynamics, learned from twelve noisy values of a function instead."""
    generator = torch.Generator().manual_seed(0)
    x = torch.cat([torch.linspace(-5, -2.5, 5), torch.linspace(-1.8, 1.5, 7)]).double()[:, None]
    noise = NOISE_STD * torch.randn(x.shape, dtype=torch.float64, generator=generator)
    gp = GPDynamics(num_inputs=1, num_outputs=1, targets="successor")
    gp.fit(x, true_function(x) + noise)
    return gp


def true_function(x: Tensor) -> Tensor:
    """The function whose noisy values are the data."""
    return (1.5 * x).sin() + 0.3 * x


def posterior(gp: GPDynamics, points: Tensor) -> Gaussian:
    """Mean (K, 1) and covariance (K, 1, 1) of the next state at inputs (K,) (Eqs. 6 and 7).

    Measurement noise is not included.
    """
    mean, variance = gp.expansion.predict(points[:, None])
    return Gaussian(mean, variance[..., None])


def sample_output(
    gp: GPDynamics, belief: Gaussian, count: int, generator: torch.Generator
) -> Tensor:
    """Draws (count,) from the exact distribution of the output at an uncertain input (Eq. 13)."""
    mean, variance = gp.expansion.predict(belief.sample(count, generator))
    white = torch.randn(mean.shape, dtype=mean.dtype, generator=generator)
    return (mean + variance.clamp(min=0).sqrt() * white)[:, 0]


def matched_output(gp: GPDynamics, belief: Gaussian) -> Moments:
    """The Gaussian with the mean and variance of the output at an uncertain input (Eqs. 14-18)."""
    return moment_match(gp.expansion, belief)
