"""Whether the next state depends on an action of the past: the evidence in recorded motions."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.checks import check_tensor
from torch_pmil.model.dynamics import GPDynamics


def evidence_of_past_action(
    states: Tensor, actions: Tensor, space: StateSpace, periods: int = 1
) -> Tensor:
    r"""Nats of evidence that a model gains by an action of the past as a further input.

    .. math:: \log p(x_{t+1} - x_t \mid x_t, u_t, u_{t-k}) - \log p(x_{t+1} - x_t \mid x_t, u_t)

    Both are the marginal likelihoods, at their largest, of all transitions whose action of the past
    is known. A robot that acts when it is told gains nothing by it; one that acts late, or has a
    part that the state does not show, gains the more, the more it was recorded. Such a robot learns
    by a state that holds past actions
    (:func:`~torch_pmil.experiments.tasks.with_history.with_history`).

    Args:
        states: x_0..x_T of rollouts, (N, T + 1, D).
        actions: u_0..u_{T-1}, (N, T, F), not all alike.
        space: of the states.
        periods: k, how many control periods ago the action was, from 1 to T - 1.

    Returns:
        Nats for each entry of the state, (D,). Below zero, the further input explained nothing.

    Raises:
        ValueError: shapes do not fit, a number is not finite, or ``periods`` is out of range.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> u = torch.randn(1, 40, 1, generator=torch.Generator().manual_seed(0)).double()
        >>> late = torch.cat([torch.zeros(1, 2, 1), u[:, :-1].cumsum(1)], 1)
        >>> bool(evidence_of_past_action(late, u, space) > 10)
        True
    """
    check_tensor("states", states, ("N", "T + 1", "D"))
    count, steps, dim = states.shape
    check_tensor("actions", actions, (count, steps - 1, "F"))
    if not 1 <= periods < steps - 1:
        raise ValueError(f"periods must be from 1 to {steps - 2}, got {periods}")
    before, after = states[:, periods:-1], states[:, periods + 1 :]
    now, past = actions[:, periods:], actions[:, :-periods]
    targets = (after - before).flatten(0, 1)
    inputs = torch.cat([space.features(before), now, past], -1).flatten(0, 1)
    nats = []
    for seen in (inputs[:, : -past.shape[-1]], inputs):
        nats.append(GPDynamics(seen.shape[1], dim).fit(seen, targets).negative_log_likelihood)
    return nats[0] - nats[1]
