"""How well a model predicts what it has not seen, over spans of time of any number of steps."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.experience import gp_data
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.particles import sample_outputs

FOLDS = 4  # consecutive parts of the motion, each predicted from the others
PARTICLES = 64
SEED = 0  # of the particles: models are compared under the same random numbers


@torch.no_grad()
def held_out_loss(
    dynamics: ForwardModel,
    states: Tensor,
    actions: Tensor,
    space: StateSpace,
    noise_std: Tensor,
    span: int,
    every: int = 1,
) -> float:
    r"""Nats per entry by which predictions of held-out observations are worse than perfect ones.

    .. math:: \frac1{SM} \sum_{t, m} \log \mathcal N(z_{t+s, m} \mid z_{t+s, m}, \sigma_m^2)
              - \log \mathcal N(z_{t+s, m} \mid \mu_{tm}, \sigma_{tm}^2 + \sigma_m^2)

    Eq. 30 compares one-step errors, which are not comparable between step lengths: in half a step
    the state moves half as far. Here particles start at a measured state and follow the executed
    actions for s steps, so that equal spans of time are compared. They give the mean and variance
    of the observation z. The task's observation noise :math:`\sigma_m` is added, since errors below
    it cost nothing. Hyper-parameters are fitted to the whole motion. Each part of it is then
    predicted from the data of the other parts.

    Args:
        dynamics: model of the states, whose data and hyper-parameters are replaced.
        states: x_0..x_T of one motion, (T + 1, D).
        actions: u_0..u_{T-1}, (T, F).
        space: of the states.
        noise_std: standard deviation of the observation noise, () or (M,).
        span: number of steps s over which the model predicts.
        every: steps between the S starts t of the predictions.

    Raises:
        ValueError: the motion is shorter than the span, or shapes do not fit.

    Example:
        >>> from torch_pmil.control.state_space import joint_match
        >>> from torch_pmil.model.dynamics import GPDynamics
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> u = torch.randn(40, 1, generator=torch.Generator().manual_seed(0)).double()
        >>> q = torch.cat([torch.zeros(1, 1), 0.1 * u.cumsum(0)])
        >>> model, noise = GPDynamics(2, 1), torch.tensor(0.01)
        >>> right = held_out_loss(model, q, u, space, noise, 4)
        >>> right < 0.1 < 1 < held_out_loss(model, q, u.flip(0), space, noise, 4)
        True
    """
    steps = len(actions)
    if not span < steps == len(states) - 1:
        raise ValueError(
            f"states must be those before and after more than {span} actions, got {len(states)} "
            f"of {steps}"
        )
    dynamics.fit_known_part(states[:-1], states[1:])
    data = gp_data(states[:-1], actions, states[1:], space, dynamics.targets)
    dynamics.fit(*data)
    fold = torch.arange(steps) * FOLDS // steps
    starts = torch.arange(0, steps - span + 1, every)
    nats = []
    for number in fold[starts].unique().tolist():
        dynamics.set_data(*(entries[fold != number] for entries in data))
        mine = starts[fold[starts] == number]
        follow = torch.stack([actions[start : start + span] for start in mine.tolist()])
        seen = space.observe(_followed(dynamics, states[mine], follow, space))
        variance = seen.var(0) + noise_std**2
        missed = space.observe(states[mine + span]) - seen.mean(0)
        nats.append((missed.square() / variance + (variance / noise_std**2).log()) / 2)
    return torch.cat(nats).mean().item()


def _followed(dynamics: ForwardModel, starts: Tensor, actions: Tensor, space: StateSpace) -> Tensor:
    """Particles (PARTICLES, S, D) that began at starts (S, D) and followed actions (S, s, F)."""
    generator = torch.Generator().manual_seed(SEED)
    known, state = dynamics.known_part(space), starts.expand(PARTICLES, -1, -1)
    for action in actions.unbind(1):
        action = action.expand(PARTICLES, -1, -1)
        inputs = torch.cat([space.features(state), action], -1)
        outputs = sample_outputs(dynamics, inputs, generator)
        state = known.successors(state, action, outputs)
    return state
