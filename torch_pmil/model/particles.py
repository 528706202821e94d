"""Trajectory distribution p(x_1), ..., p(x_T) by Monte Carlo, beside moment matching."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_pmil.checks import check_whole
from torch_pmil.control.policy import Policy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, normal, symmetric
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.model.rollout import PredictionError, check_finite, check_start_belief
from torch_pmil.seeds import LARGEST_SEED


def sample_trajectories(
    initial: Gaussian,
    policy: Policy,
    dynamics: ForwardModel,
    space: StateSpace,
    horizon: int,
    count: int,
    generator: torch.Generator,
    observation_noise: bool = True,
) -> Tensor:
    r"""Sampled trajectories, the Monte Carlo counterpart of :func:`predict_trajectory`.

    .. math::
        x_{t+1} = \mu(x_t, \pi(x_t)) + \sigma(x_t, \pi(x_t)) \, \epsilon_t,
        \qquad \epsilon_t \sim \mathcal N(0, I)

    Given the draws, the states are differentiable in the policy. A longer horizon begins with the
    draws of a shorter one.

    Args:
        initial, policy, dynamics, space, horizon, observation_noise: as in
            :func:`predict_trajectory`.
        count: number of particles.
        generator: seeded source of the draws.

    Returns:
        States at t = 1..T, (count, *batch, T, D).

    Raises:
        ValueError, NotPositiveDefiniteError: as :func:`check_start_belief`.
    """
    return sample_rollouts(
        initial, policy, dynamics, space, horizon, count, generator, observation_noise
    )[..., 1:, :]


def sample_rollouts(
    initial: Gaussian,
    policy: Policy,
    dynamics: ForwardModel,
    space: StateSpace,
    horizon: int,
    count: int,
    generator: torch.Generator,
    observation_noise: bool = True,
) -> Tensor:
    """:func:`sample_trajectories` from t = 0 on: (count, *batch, T + 1, D)."""
    check_start_belief(initial, "initial", dynamics, space)
    check_whole("horizon", horizon, 1)
    check_whole("count", count, 1)
    controller, state = policy.controller, initial.sample(count, generator)
    states, known = [state], dynamics.known_part(space)
    for _ in range(horizon):
        features = space.features(state)
        action = controller(features)
        inputs = torch.cat([features, action], -1)
        outputs = sample_outputs(dynamics, inputs, generator, observation_noise)
        state = known.successors(state, action, outputs)
        states.append(state)
    return torch.stack(states, -2)


def sample_outputs(
    dynamics: ForwardModel,
    inputs: Tensor,
    generator: torch.Generator,
    observation_noise: bool = True,
) -> Tensor:
    """Outputs (*batch, E) drawn anew at inputs (*batch, D' + F)."""
    mean, variance = dynamics.predict(inputs)
    if observation_noise:
        variance = variance + dynamics.noise
    return mean + variance.clamp(min=0).sqrt() * normal(mean.shape, mean, generator)


@dataclass(frozen=True)
class ParticlePrediction:
    r"""Prediction like :func:`predict_trajectory`, by Gaussians fitted to particles at each step.

    Moment matching takes every marginal as Gaussian; particles keep their shape, with a Monte Carlo
    error in proportion to :math:`1 / \sqrt{\text{count}}`. All predictions use the same random
    numbers, as in PEGASUS (Ng and Jordan 2000, UAI): the loss of a search is a smooth function of
    the policy, and a resumed run predicts as one that was not stopped.

    Args:
        count: number of particles, at least two.
        seed: seed of the random numbers.

    Example:
        >>> from torch_pmil import GPDynamics, RBFPolicy, joint_match
        >>> space = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
        >>> policy = RBFPolicy(torch.zeros(3, 1), torch.ones(1), torch.ones(1))
        >>> dynamics = GPDynamics(2, 1)
        >>> dynamics.set_data(torch.eye(2), torch.zeros(2, 1))
        >>> start = Gaussian(torch.zeros(1).double(), torch.eye(1).double())
        >>> ParticlePrediction(count=100)(start, policy, dynamics, space, horizon=5).mean.shape
        torch.Size([5, 1])
    """

    count: int
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "count", check_whole("count", self.count, 2))
        object.__setattr__(self, "seed", check_whole("seed", self.seed, 0, LARGEST_SEED))

    def __call__(
        self,
        initial: Gaussian,
        policy: Policy,
        dynamics: ForwardModel,
        space: StateSpace,
        horizon: int,
    ) -> Gaussian:
        """Predicted marginals p(x_1), ..., p(x_T), mean (*batch, T, D), with observation noise.

        Raises:
            PredictionError: names the time step and the state that is not finite.
        """
        states = self.rollouts(initial, policy, dynamics, space, horizon)
        trajectory = _fitted(states[..., 1:, :])
        try:
            check_finite(trajectory, space)
        except PredictionError as error:
            features = space.features(states[..., error.step - 1, :])
            fault = dynamics.fault_at(torch.cat([features, policy.controller(features)], -1))
            if not fault:
                raise
            raise PredictionError(f"{error}: {fault}", error.step) from error
        return trajectory

    def rollouts(
        self,
        initial: Gaussian,
        policy: Policy,
        dynamics: ForwardModel,
        space: StateSpace,
        horizon: int,
    ) -> Tensor:
        """The particles themselves, at t = 0..T, (count, *batch, T + 1, D)."""
        draws = self.count, torch.Generator().manual_seed(self.seed)
        return sample_rollouts(initial, policy, dynamics, space, horizon, *draws)


def _fitted(samples: Tensor) -> Gaussian:
    """Mean and unbiased covariance of samples (N, *batch, D)."""
    mean = samples.mean(0)
    deviation = samples - mean
    cov = torch.einsum("n...i,n...j->...ij", deviation, deviation) / (len(samples) - 1)
    return Gaussian(mean, symmetric(cov))
