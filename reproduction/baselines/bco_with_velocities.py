"""Behavioural cloning from observation with given velocities, with Gaussian processes.

It is BCO with more knowledge, and with regressions that need fewer data: a bound of what cloning of
inferred actions can do. The recordings of the double pendulum show positions at 10 Hz. Central
differences of them miss the velocities by so much that an inverse model, right as it may be, infers
actions that did not happen.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from reproduction.baselines.bco import ClonesFromObservation
from reproduction.baselines.behavioral_cloning import clone_behavior
from reproduction.baselines.cloning import record_pairs
from reproduction.baselines.learned_inverse_dynamics import PILCO_SIGNAL_TO_NOISE
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task


class BCOWithVelocities(ClonesFromObservation):
    """BCO with the demonstrator's velocities, and means of Gaussian processes in both places.

    Their hyper-parameters are of maximum marginal likelihood.

    Args:
        experiment: that of the double pendulum, or another with its recordings.
        seed: of the exploration.
        noise: standard deviation of the exploration, as a fraction of half the action's range.

    Raises:
        ValueError: the experiment has other recordings.
    """

    label: ClassVar[str] = "BCO with GPs, given velocities"
    name: ClassVar[str] = "bco_with_velocities"

    def __init__(self, experiment: Task, seed: int, noise: float = 0.1) -> None:
        super().__init__(experiment, seed, noise)
        shown = experiment.demonstrations.positions
        recorded = load_experiment("double_pendulum").demonstrations.positions
        if not torch.equal(shown, recorded[:, : shown.shape[1]]):
            raise ValueError(
                f"the recordings must be those of double_pendulum, of which alone the velocities "
                f"are known, got those of {experiment.name}"
            )
        self._states = next(record_pairs([0]))[0][:, : shown.shape[1]]
        F = len(experiment.actions.names)
        self.model = GPDynamics(self.inverse_width, F, "successor", PILCO_SIGNAL_TO_NOISE)
        self.clone: StatePolicy | None = None

    @property
    def demonstrated_states(self) -> Tensor:
        """The states of the demonstrator (N, T + 1, D)."""
        return self._states

    def learn_inverse(self, inputs: Tensor, fractions: Tensor) -> None:
        """Fit the Gaussian process."""
        self.model.fit(inputs, fractions.double())

    def learn_policy(self, states: Tensor, fractions: Tensor) -> None:
        """Clone as a policy of Eqs. 25-27."""
        limits, period = torch.ones(fractions.shape[-1]), self.experiment.demonstrations.time_step
        self.clone = clone_behavior(states, fractions, self.experiment.space, limits, period)

    def inverse(self, inputs: Tensor) -> Tensor:
        """Mean of the Gaussian process."""
        return self.model.expansion.mean(inputs)

    def policy(self, states: Tensor) -> Tensor:
        """The clone's actions; RuntimeError before any fit."""
        if self.clone is None:
            raise RuntimeError("the policy acts once it is cloned: call fit first")
        return self.clone(states)
