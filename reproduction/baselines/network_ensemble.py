r"""A model of a robot by an ensemble of probabilistic networks, as in PETS.

Each of E networks predicts a Gaussian of the state's difference, and particles that stay with their
network (TS-infinity) carry a state through a plan.

.. math:: x_{t+1} - x_t \sim \mathcal N(\mu_e(x_t, u_t), \Sigma_e(x_t, u_t))

Source: K. Chua, R. Calandra, R. McAllister, S. Levine (2018), Deep reinforcement learning in a
handful of trials using probabilistic dynamics models, NeurIPS, Sections 4 and 5.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn
from torch.nn.functional import gaussian_nll_loss, silu, softplus

from reproduction.baselines.networks import LEAST_STD, Scaled, descend, seeded, to_unit
from torch_pmil.tasks.task import Task

BATCH = 64  # rows of a step, for each member
MEMBERS, CELLS = 5, 64  # E, and cells of each hidden layer
WEIGHT_DECAY = 1e-2  # of the networks
LOG_VARIANCES = -10.0, 0.5  # range of the networks' outputs, of scaled differences


class Ensemble(nn.Module):
    """E networks of two hidden layers, each of a diagonal Gaussian of O outputs.

    Args:
        inputs: I.
        outputs: O.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        pairs = list(itertools.pairwise([inputs, CELLS, CELLS, 2 * outputs]))
        self.weights = nn.ParameterList(
            nn.Parameter(torch.randn(MEMBERS, rows, columns) / rows**0.5) for rows, columns in pairs
        )
        self.biases = nn.ParameterList(
            nn.Parameter(torch.zeros(MEMBERS, 1, columns)) for _, columns in pairs
        )

    def forward(self, inputs: Tensor) -> Tensor:
        """Means and log variances (E, n, 2 O) of each member at its own inputs (E, n, I)."""
        hidden = inputs
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = silu(torch.baddbmm(bias, hidden, weight))
        return torch.baddbmm(self.biases[-1], hidden, self.weights[-1])


class EnsembleModel:
    """A model of a robot's state difference.

    Args:
        experiment: whose robot it is.
        steps: of Adam in each fit.
        learning_rate: of Adam.
        generator: of all random numbers.
    """

    def __init__(
        self, experiment: Task, steps: int, learning_rate: float, generator: torch.Generator
    ) -> None:
        self.experiment, self.steps, self.generator = experiment, steps, generator
        D = experiment.space.dim
        inputs = len(experiment.space.feature_names) + len(experiment.actions.names)
        with seeded(generator):
            self.network = Scaled(Ensemble(inputs, D), inputs)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=learning_rate, weight_decay=WEIGHT_DECAY
        )
        self.difference_std = torch.ones(D)

    def fit(self, states: Tensor, actions: Tensor, following: Tensor) -> None:
        """Go on to learn from all transitions (n, ...), each member from a sample of its own."""
        inputs = self._inputs(states.float(), to_unit(actions, self.experiment.actions))
        differences = (following - states).float()
        self.network.set_scale(inputs)
        self.difference_std = differences.std(0).clamp_min(LEAST_STD)
        targets, n = differences / self.difference_std, len(inputs)
        own = torch.randint(n, (MEMBERS, n), generator=self.generator)

        def loss(rows: Tensor) -> Tensor:
            mean, log_variance = self._moments(inputs[own[:, rows]])
            return gaussian_nll_loss(mean, targets[own[:, rows]], log_variance.exp())

        descend(loss, self.optimizer, n, BATCH, self.steps, self.generator)

    @torch.no_grad()
    def sample(self, states: Tensor, fractions: Tensor) -> Tensor:
        """Next states (E, n, D) of particles at states (E, n, D), each with its own network.

        Actions are fractions (E, n, F) of half their range.
        """
        mean, log_variance = self._moments(self._inputs(states, fractions))
        noise = torch.randn(mean.shape, generator=self.generator)
        return states + self.difference_std * (mean + (log_variance / 2).exp() * noise)

    def _inputs(self, states: Tensor, fractions: Tensor) -> Tensor:
        return torch.cat([self.experiment.space.features(states), fractions], -1)

    def _moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of scaled differences; the latter bounded as in PETS."""
        mean, log_variance = self.network(inputs).chunk(2, -1)
        low, high = LOG_VARIANCES
        log_variance = high - softplus(high - log_variance)
        return mean, low + softplus(log_variance - low)
