r"""Behavioural cloning from observation, BCO(alpha), in turns with own rollouts.

An inverse model of the robot, learned from its own motion, infers the actions that the demonstrator
would have needed; a policy is cloned from these.

.. math:: \tilde u_t = f_\theta(x^{\exp}_t, x^{\exp}_{t+1}), \qquad
    \min_\phi \sum_t \lVert \tilde u_t - \pi_\phi(x^{\exp}_t) \rVert^2

Both are networks with a Gaussian of fixed variance around them, so maximum likelihood is least
squares.

Source: F. Torabi, G. Warnell, P. Stone (2018), Behavioral cloning from observation, IJCAI,
Algorithm 1.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

from reproduction.baselines.networks import Scaled, descend, from_unit, seeded, to_unit
from reproduction.baselines.peer import Peer
from torch_pmil.tasks.task import Task

BATCH = 256  # rows of a step
CELLS = 64  # of each of the two hidden layers of the networks


class ClonesFromObservation(Peer):
    """A peer that infers the demonstrated actions, clones them, and explores around the clone.

    Actions are fractions of half their ranges.

    Args:
        experiment: what to learn.
        seed: of the learner and the exploration.
        noise: standard deviation of the exploration, as a fraction of half the action's range.
    """

    def __init__(self, experiment: Task, seed: int, noise: float) -> None:
        super().__init__(experiment, seed)
        self.noise = noise
        self.inverse_width = len(experiment.space.feature_names) + experiment.space.dim

    def fit(self) -> None:
        """Learn the inverse model from all rollouts, then clone the demonstrations."""
        states, actions, following = self.transitions
        fractions = to_unit(actions, self.experiment.actions)
        self.learn_inverse(self._inverse_inputs(states, following), fractions)
        shown, next_shown = self.demonstrated_transitions
        self.learn_policy(shown, self.infer(shown, next_shown))

    @abstractmethod
    def learn_inverse(self, inputs: Tensor, fractions: Tensor) -> None:
        """Learn the inverse model from inputs (n, ``inverse_width``) and actions (n, F)."""

    @abstractmethod
    def learn_policy(self, states: Tensor, fractions: Tensor) -> None:
        """Clone actions (n, F) in states (n, D)."""

    @abstractmethod
    def inverse(self, inputs: Tensor) -> Tensor:
        """Actions (n, F) of the inverse model at inputs (n, ``inverse_width``)."""

    @abstractmethod
    def policy(self, states: Tensor) -> Tensor:
        """Actions (*batch, F) of the cloned policy in states (*batch, D)."""

    @torch.no_grad()
    def infer(self, states: Tensor, following: Tensor) -> Tensor:
        """Actions (n, F) that lead from states to next ones (n, D)."""
        return self.inverse(self._inverse_inputs(states, following)).clamp(-1, 1)

    @torch.no_grad()
    def act(self, step: int, states: Tensor) -> Tensor:
        """The policy's mean actions."""
        return from_unit(self.policy(states), self.experiment.actions)

    @torch.no_grad()
    def explore(self, step: int, states: Tensor) -> Tensor:
        """The policy's actions with Gaussian noise."""
        mean = self.policy(states)
        noise = self.noise * torch.randn(mean.shape, generator=self.generator)
        return from_unit(mean + noise, self.experiment.actions)

    def _inverse_inputs(self, states: Tensor, following: Tensor) -> Tensor:
        return torch.cat([self.experiment.space.features(states), following - states], -1)


class BCO(ClonesFromObservation):
    """Behavioural cloning from observation.

    Args:
        experiment: what to learn.
        seed: of the networks and the exploration.
        steps: of Adam for each network in a fit; as many as transitions are new, if these are more.
        learning_rate: of Adam.
        weight_decay: of the networks.
        noise: standard deviation of the exploration, as a fraction of half the action's range.
    """

    label: ClassVar[str] = "BCO"
    name: ClassVar[str] = "bco"

    def __init__(
        self,
        experiment: Task,
        seed: int,
        steps: int = 500,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-4,
        noise: float = 0.1,
    ) -> None:
        super().__init__(experiment, seed, noise)
        self.least_steps = self.steps = steps
        features = len(experiment.space.feature_names)
        F = len(experiment.actions.names)
        with seeded(self.generator):
            self.inferring, self.cloning = (
                Regression(inputs, F, learning_rate, weight_decay)
                for inputs in (self.inverse_width, features)
            )

    def learn_inverse(self, inputs: Tensor, fractions: Tensor) -> None:
        """Go on to fit the first network."""
        self.steps = self.steps_of_fit(self.least_steps)
        self.inferring.fit(inputs, fractions, self.steps, self.generator)

    def learn_policy(self, states: Tensor, fractions: Tensor) -> None:
        """Go on to fit the second network."""
        features = self.experiment.space.features(states)
        self.cloning.fit(features, fractions, self.steps, self.generator)

    def inverse(self, inputs: Tensor) -> Tensor:
        """Outputs of the first network."""
        return self.inferring.network(inputs)

    def policy(self, states: Tensor) -> Tensor:
        """Outputs of the second network."""
        return self.cloning.network(self.experiment.space.features(states))


class Regression:
    """A network of pairs (n, I) and (n, F), by least squares.

    Args:
        inputs: I.
        outputs: F.
        learning_rate, weight_decay: of AdamW.
    """

    def __init__(
        self, inputs: int, outputs: int, learning_rate: float, weight_decay: float
    ) -> None:
        layers = MLP(inputs, outputs, num_cells=[CELLS, CELLS], activation_class=nn.Tanh)
        self.network = Scaled(layers, inputs)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=learning_rate, weight_decay=weight_decay
        )

    def fit(self, inputs: Tensor, targets: Tensor, steps: int, generator: torch.Generator) -> None:
        """Go on with so many steps on these pairs."""
        self.network.set_scale(inputs)

        def loss(rows: Tensor) -> Tensor:
            return (self.network(inputs[rows]) - targets[rows]).square().mean()

        descend(loss, self.optimizer, len(inputs), BATCH, steps, generator)
