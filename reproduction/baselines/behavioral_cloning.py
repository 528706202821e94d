r"""Behavioural cloning: a policy fitted to recorded states and actions (Section 5.1.2).

It is the only method that sees the demonstrator's torques. It learns the demonstrator's policy,
whatever the robot that will use it: where their bodies differ, so do the torques that they need.

The regression is a GP for each torque with hyper-parameters of maximum marginal likelihood. Its
posterior mean is a network of as many Gaussian basis functions as there are pairs, so the result is
the policy of Eqs. 25-27, squashed to the torque limits.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.policy import before_squashing
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.dynamics import GPDynamics


def clone_behavior(
    states: Tensor, torques: Tensor, space: StateSpace, u_max: Tensor, control_period: float
) -> StatePolicy:
    r"""The policy :math:`\pi(x) = u_{\max} \sin m(x)` with the mean m of a GP.

    The GP is of :math:`\arcsin(u / u_{\max})` on the state's features.

    Args:
        states: (S, D), in which the demonstrator acted.
        torques: (S, F), N·m, that it applied there.
        space: which states are angles.
        u_max: torque limits (F,), N·m.
        control_period: for which a torque is held, s.

    Returns:
        The policy: states (*batch, D) to torques (*batch, F); ``as_tensordict_module()`` is for
        ``env.rollout``.

    Raises:
        ValueError: shapes do not fit each other, a number is not finite, or a torque is beyond its
            limit.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> generator = torch.Generator().manual_seed(0)
        >>> states = torch.randn(60, 2, dtype=torch.float64, generator=generator)
        >>> torques, u_max = -states[:, :1].sin(), torch.tensor([2.0])
        >>> policy = clone_behavior(states, torques, space, u_max, control_period=0.1)
        >>> round(policy(torch.tensor([torch.pi / 6, 0.0])).item(), 2)
        -0.5
    """
    _check_pairs(states, torques, space, u_max)
    features = space.features(states.double())
    targets = before_squashing((torques / u_max).double())
    gp = GPDynamics(features.shape[-1], len(u_max))
    gp.fit(features, targets)
    policy = RBFPolicy(features, u_max, torch.ones(features.shape[-1]))
    mean = gp.expansion
    policy.weights.data.copy_((mean.signal_variance[:, None] * mean.weights).mT)
    policy.log_widths.data.copy_(mean.lengthscales.log())
    return StatePolicy(policy.requires_grad_(False), space, control_period)


def _check_pairs(states: Tensor, torques: Tensor, space: StateSpace, u_max: Tensor) -> None:
    pairs = len(states)
    if states.shape != (pairs, space.dim) or torques.shape != (pairs, len(u_max)):
        raise ValueError(
            f"states must be (S, {space.dim}) and torques (S, {len(u_max)}), got "
            f"{tuple(states.shape)} and {tuple(torques.shape)}"
        )
    if not (torques.abs() <= u_max).all():
        raise ValueError(
            f"torques must be finite and within ± {u_max.tolist()} N·m, got "
            f"{torques.abs().amax(0).tolist()}"
        )
