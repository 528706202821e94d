r"""Behavioural cloning from observation, BCO(alpha), in turns with own rollouts.

An inverse model of the robot, learned from its own motion, tells the actions that the demonstrator
would have needed; a policy is cloned from these.

.. math:: \tilde u_t = f_\theta(x^{\exp}_t, x^{\exp}_{t+1}), \qquad
    \min_\phi \sum_t \lVert \tilde u_t - \pi_\phi(x^{\exp}_t) \rVert^2

Both are networks with a Gaussian of fixed variance around them, so maximum likelihood is least
squares.

Source: F. Torabi, G. Warnell, P. Stone (2018), Behavioral cloning from observation, IJCAI,
Algorithm 1.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

from reproduction.baselines.networks import Scaled, descend, from_unit, seeded, to_unit
from reproduction.baselines.peer import Peer
from torch_pmil.experiments.tasks.experiment import Experiment

BATCH = 256  # rows of a step


class BCO(Peer):
    """Behavioural cloning from observation.

    Args:
        experiment: what to learn.
        seed: of the networks and the exploration.
        cells: of each of the two hidden layers.
        steps: of Adam for each network in a fit; as many as transitions are new, if these are more.
        learning_rate: of Adam.
        weight_decay: of the networks.
        noise: standard deviation of the exploration, as a fraction of half the action's range.
    """

    label: ClassVar[str] = "BCO"
    name: ClassVar[str] = "bco"

    def __init__(
        self,
        experiment: Experiment,
        seed: int,
        cells: int = 64,
        steps: int = 500,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-4,
        noise: float = 0.1,
    ) -> None:
        super().__init__(experiment, seed)
        self.steps, self.noise = steps, noise
        features, D = len(experiment.space.feature_names), experiment.space.dim
        F = len(experiment.actions.names)
        with seeded(self.generator):
            self.inverse, self.policy = (
                Scaled(MLP(inputs, F, num_cells=[cells, cells], activation_class=nn.Tanh), inputs)
                for inputs in (features + D, features)
            )
        self.optimizers = {
            network: torch.optim.AdamW(
                network.parameters(), lr=learning_rate, weight_decay=weight_decay
            )
            for network in (self.inverse, self.policy)
        }

    def fit(self) -> None:
        """Learn the inverse model from all rollouts, then clone the demonstrations."""
        steps, (states, actions, following) = self.begin_fit(self.steps), self.transitions
        inputs = self._inverse_inputs(states, following)
        self._regress(self.inverse, inputs, to_unit(actions, self.experiment.actions), steps)
        shown, next_shown = self.demonstrated_transitions
        labels = self.infer(shown, next_shown)
        self._regress(self.policy, self.experiment.space.features(shown), labels, steps)

    @torch.no_grad()
    def infer(self, states: Tensor, following: Tensor) -> Tensor:
        """Actions that lead from states to next ones (n, D), as fractions of half their range."""
        return self.inverse(self._inverse_inputs(states, following)).clamp(-1, 1)

    def act(self, step: int, states: Tensor) -> Tensor:
        """The policy's mean actions."""
        return from_unit(self._policy(states), self.experiment.actions)

    def explore(self, step: int, states: Tensor) -> Tensor:
        """The policy's actions with Gaussian noise."""
        mean = self._policy(states)
        noise = self.noise * torch.randn(mean.shape, generator=self.generator)
        return from_unit(mean + noise, self.experiment.actions)

    @torch.no_grad()
    def _policy(self, states: Tensor) -> Tensor:
        return self.policy(self.experiment.space.features(states))

    def _inverse_inputs(self, states: Tensor, following: Tensor) -> Tensor:
        return torch.cat([self.experiment.space.features(states), following - states], -1)

    def _regress(self, network: Scaled, inputs: Tensor, targets: Tensor, steps: int) -> None:
        """Go on to fit a network to pairs (n, I) and (n, F) by steps of least squares."""
        network.set_scale(inputs)

        def loss(rows: Tensor) -> Tensor:
            return (network(inputs[rows]) - targets[rows]).square().mean()

        optimizer = self.optimizers[network]
        descend(loss, optimizer, len(inputs), BATCH, steps, self.generator)
