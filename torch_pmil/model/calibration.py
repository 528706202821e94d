"""Calibration of a model: how sure it is of executed transitions, against how right it is."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel


@torch.no_grad()
def standardised_residuals(
    dynamics: ForwardModel, space: StateSpace, states: Tensor, actions: Tensor
) -> Tensor:
    r"""Errors of the one-step prediction at executed transitions, in predicted standard deviations.

    .. math::
        z_{t+1} = \frac{x_{t+1} - A\,[x_t, u_t] - C \mu(x_t, u_t)}
            {\sqrt{C^2 (\sigma^2(x_t, u_t) + \sigma_\varepsilon^2)}}

    They are standard normal if the model is as sure as it is right (Eqs. 6 and 7, with the noise of
    Eq. 2). A and C are those of its known part, C^2 the squares of C's entries. Entries of which
    nothing is learned have the residual 0.

    Args:
        dynamics: the forward model.
        space: the robot's state space.
        states: rollouts x_0..x_T, (*batch, T + 1, D), preferably new to the model.
        actions: u_0..u_{T-1}, (*batch, T, F).

    Returns:
        z_1..z_T, (*batch, T, D), without a unit.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> from torch_pmil.model.dynamics import GPDynamics
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> dynamics = GPDynamics(num_inputs=2, num_outputs=1)
        >>> dynamics.set_data(torch.zeros(2, 2), torch.zeros(2, 1))
        >>> states, actions = torch.zeros(4, 3, 1).double(), torch.zeros(4, 2, 1).double()
        >>> standardised_residuals(dynamics, space, states, actions).shape
        torch.Size([4, 2, 1])
    """
    before, known = states[..., :-1, :], dynamics.known_part(space)
    mean, variance = dynamics.predict(torch.cat([space.features(before), actions], -1))
    error = states[..., 1:, :] - known.successors(before, actions, mean)
    std = ((variance + dynamics.noise) @ known.gain.square().mT).sqrt()
    return torch.where(known.uncertain, error / std, 0.0)


def observed_coverage(residuals: Tensor, probabilities: Tensor) -> Tensor:
    r"""Fraction of standardised residuals inside central intervals of given probabilities.

    .. math:: \widehat{\Pr}\big[ |z| \le \Phi^{-1}(\tfrac{1 + p}{2}) \big]

    Args:
        residuals: (\*batch, D).
        probabilities: p of each of K intervals, from 0 to 1, (K,).

    Returns:
        Fractions for each interval and entry, (K, D).

    Example:
        >>> residuals = torch.tensor([[0.0], [1.0], [3.0]])
        >>> observed_coverage(residuals, torch.tensor([0.0, 0.5, 0.95, 1.0])).flatten()
        tensor([0.3333, 0.3333, 0.6667, 1.0000])
    """
    check_tensor("residuals", residuals.flatten(0, -2), ("N", "D"), finite=False)
    if not ((probabilities >= 0) & (probabilities <= 1)).all():
        raise ValueError(f"probabilities must be from 0 to 1, got {probabilities.tolist()}")
    reach = math.sqrt(2) * torch.special.erfinv(probabilities)
    inside = residuals.reshape(-1, residuals.shape[-1]).abs() <= reach[:, None, None]
    return inside.to(residuals.dtype).mean(1)


def two_sigma_coverage(predicted: Gaussian, executed: Tensor) -> float:
    """Fraction of executed entries within two standard deviations of the predicted mean.

    ``predicted`` holds marginals at t = 1..T, mean (T, D); ``executed`` holds rollouts x_0..x_T,
    (N, T + 1, D).

    Example:
        >>> still = Gaussian(torch.zeros(2, 1), torch.ones(2, 1, 1))
        >>> two_sigma_coverage(still, torch.tensor([[[0.0], [1.0], [3.0]]]))
        0.5
    """
    return within_two_sigma(predicted, executed).mean().item()


def two_sigma_coverage_by_entry(predicted: Gaussian, executed: Tensor) -> Tensor:
    """:func:`two_sigma_coverage` of each entry, (D,)."""
    return within_two_sigma(predicted, executed).mean((0, 1))


def within_two_sigma(predicted: Gaussian, executed: Tensor) -> Tensor:
    """Whether executed entries at t = 1..T are within two standard deviations, 1 or 0, (N, T, D).

    Raises ValueError where the rollouts have other steps or entries than the marginals.
    """
    steps, entries = predicted.mean.shape
    check_tensor("executed", executed, ("N", steps + 1, entries), finite=False)
    return ((executed[:, 1:] - predicted.mean).abs() <= 2 * predicted.std).double()
