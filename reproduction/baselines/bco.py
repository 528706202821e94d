r"""Behavioural cloning from observation, BCO(alpha), in turns with own rollouts.

An inverse model of the robot, learned from its own motion, tells the actions that the demonstrator
would have needed; a policy is cloned from these.

.. math:: \tilde u_t = f(x^{\exp}_t, x^{\exp}_{t+1}), \qquad \pi(x^{\exp}_t) \approx \tilde u_t

The paper has networks for both. Here both are means of Gaussian processes with hyper-parameters of
maximum marginal likelihood, which learn from fewer data.

Source: F. Torabi, G. Warnell, P. Stone (2018), Behavioral cloning from observation, IJCAI,
Algorithm 1.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from reproduction.baselines.behavioral_cloning import clone_behavior
from reproduction.baselines.learned_inverse_dynamics import PILCO_SIGNAL_TO_NOISE
from reproduction.baselines.networks import from_unit, to_unit
from reproduction.baselines.peer import Peer
from reproduction.cloning import record_pairs
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.tasks.experiment import Experiment
from torch_pmil.model.dynamics import GPDynamics


class BCO(Peer):
    """Behavioural cloning from observation.

    Args:
        experiment: what to learn.
        seed: of the exploration.
        noise: standard deviation of the exploration, as a fraction of half the action's range.
    """

    label: ClassVar[str] = "BCO"
    name: ClassVar[str] = "bco"

    def __init__(self, experiment: Experiment, seed: int, noise: float = 0.1) -> None:
        super().__init__(experiment, seed)
        self.noise = noise
        inputs = len(experiment.space.feature_names) + experiment.space.dim
        F = len(experiment.actions.names)
        self.inverse = GPDynamics(inputs, F, "successor", PILCO_SIGNAL_TO_NOISE)
        self.policy: StatePolicy | None = None

    def fit(self) -> None:
        """Learn the inverse model from all rollouts, then clone the demonstrations."""
        experiment, (states, actions, following) = self.experiment, self.transitions
        fractions = to_unit(actions, experiment.actions).double()
        self.inverse.fit(self._inverse_inputs(states, following), fractions)
        shown, next_shown = self.demonstrated_transitions
        labels = self.infer(shown, next_shown)
        limits, period = torch.ones(labels.shape[-1]), experiment.demonstrations.time_step
        self.policy = clone_behavior(shown, labels, experiment.space, limits, period)

    @torch.no_grad()
    def infer(self, states: Tensor, following: Tensor) -> Tensor:
        """Actions that lead from states to next ones (n, D), as fractions of half their range."""
        return self.inverse.expansion.mean(self._inverse_inputs(states, following)).clamp(-1, 1)

    def act(self, step: int, states: Tensor) -> Tensor:
        """The policy's actions."""
        return from_unit(self._fractions(states), self.experiment.actions)

    def explore(self, step: int, states: Tensor) -> Tensor:
        """The policy's actions with Gaussian noise."""
        mean = self._fractions(states)
        noise = self.noise * torch.randn(mean.shape, generator=self.generator)
        return from_unit(mean + noise, self.experiment.actions)

    @torch.no_grad()
    def _fractions(self, states: Tensor) -> Tensor:
        if self.policy is None:
            raise RuntimeError("BCO acts once it is fitted: call fit first")
        return self.policy(states)

    def _inverse_inputs(self, states: Tensor, following: Tensor) -> Tensor:
        return torch.cat([self.experiment.space.features(states), following - states], -1)


class ToldBCO(BCO):
    """BCO that is told the velocities too, which the recordings of the double pendulum lack.

    Central differences of positions at 10 Hz miss them by so much that the inverse model, right as
    it may be, infers actions that did not happen.

    Args:
        experiment: that of the double pendulum.
        seed, noise: as of :class:`BCO`.

    Raises:
        ValueError: the experiment is another one.
    """

    label: ClassVar[str] = "BCO, told the velocities"
    name: ClassVar[str] = "bco_told"

    def __init__(self, experiment: Experiment, seed: int, noise: float = 0.1) -> None:
        super().__init__(experiment, seed, noise)
        shown = experiment.demonstrations.positions
        recorded = load_experiment("double_pendulum").demonstrations.positions
        if not torch.equal(shown, recorded[:, : shown.shape[1]]):
            raise ValueError(
                f"the recordings must be those of double_pendulum, of which alone the velocities "
                f"are known, got those of {experiment.name}"
            )
        self._told = next(record_pairs([0]))[0][:, : shown.shape[1]]

    @property
    def demonstrated_states(self) -> Tensor:
        """The states of the demonstrator (N, T + 1, D)."""
        return self._told
