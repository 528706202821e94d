r"""How sure a model is of its next state, against how right it is: one-step predictions beside transitions that were executed."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_pmil.dynamics import GPDynamics
from torch_pmil.experience import gp_data
from torch_pmil.state_space import StateSpace


@torch.no_grad()
def standardised_residuals(dynamics: GPDynamics, space: StateSpace, states: Tensor, actions: Tensor) -> Tensor:
    r"""Errors of the one-step prediction at every executed transition, in predicted standard deviations.

    .. math:: z_{t+1} = \frac{x_{t+1} - \mu(x_t, u_t)}{\sqrt{\sigma^2(x_t, u_t) + \sigma_\varepsilon^2}}

    Of a model that is as sure as it is right these are standard normal (Eqs. 6 and 7, with the noise of Eq. 2).

    Args:
        dynamics: the forward model.
        space: of the same robot.
        states: rollouts x_0..x_T, (*batch, T + 1, D), best of such that the model has not learned from.
        actions: u_0..u_{T-1}, (*batch, T, F).

    Returns:
        z_1..z_T, (*batch, T, D), without a unit.

    Raises:
        RuntimeError: the model has no data.

    Example:
        >>> from torch_pmil.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> dynamics = GPDynamics(num_inputs=2, num_outputs=1)
        >>> dynamics.set_data(torch.zeros(2, 2), torch.zeros(2, 1))
        >>> standardised_residuals(dynamics, space, torch.zeros(4, 3, 1).double(), torch.zeros(4, 2, 1).double()).shape
        torch.Size([4, 2, 1])
    """
    inputs, targets = gp_data(states[..., :-1, :], actions, states[..., 1:, :], space, dynamics.targets)
    mean, variance = dynamics.expansion.predict(inputs)
    return (targets - mean) / (variance + dynamics.expansion.noise_variance).sqrt()


def observed_coverage(residuals: Tensor, probabilities: Tensor) -> Tensor:
    r"""Fraction of standardised residuals inside the central interval that should hold them with a given probability.

    .. math:: \widehat{\Pr}\big[ |z| \le \Phi^{-1}(\tfrac{1 + p}{2}) \big]

    Args:
        residuals: (\*batch, D).
        probabilities: p of K intervals, from 0 to 1, (K,).

    Returns:
        For each entry, (K, D).

    Example:
        >>> observed_coverage(torch.tensor([[0.0], [1.0], [3.0]]), torch.tensor([0.0, 0.5, 0.95, 1.0])).flatten()
        tensor([0.3333, 0.3333, 0.6667, 1.0000])
    """
    reach = math.sqrt(2) * torch.special.erfinv(probabilities)
    inside = residuals.reshape(-1, residuals.shape[-1]).abs() <= reach[:, None, None]
    return inside.to(residuals.dtype).mean(1)
