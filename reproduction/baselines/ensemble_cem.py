r"""An ensemble of probabilistic networks, and a planner that tracks the demonstrations with it.

The model is that of PETS: each of E networks tells a Gaussian of the state's difference, and
particles that stay with their network (TS-infinity) carry a state through a plan. The cross-entropy
method finds the plan, whose first action is executed before it is planned anew.

.. math:: x_{t+1} - x_t \sim \mathcal N(\mu_e(x_t, u_t), \Sigma_e(x_t, u_t)), \qquad
    \min_{u_{t..t+H-1}} \frac{1}{E} \sum_e \sum_{k=t+1}^{t+H}
    \frac{d_k^2}{1 + d_k^2 / c}, \qquad
    d_k^2 = \lVert z(x^e_k) - \mu^{\exp}_k \rVert^2_{(\Sigma^{\exp}_k)^{-1}}

PETS has a task's reward in place of this distance to the demonstrated marginals, in the match space
z. The distance saturates: otherwise the way counts for so much that a plan gives up its end.

TorchRL's ``CEMPlanner`` begins each plan at mean 0 and standard deviation 1 of its actions, and
goes through an environment at about 0.5 ms a step; here a plan goes on from the last one.

Source: K. Chua, R. Calandra, R. McAllister, S. Levine (2018), Deep reinforcement learning in a
handful of trials using probabilistic dynamics models, NeurIPS.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn.functional import gaussian_nll_loss, silu, softplus

from reproduction.baselines.networks import (
    LEAST_STD,
    Scaled,
    descend,
    from_unit,
    seeded,
    to_unit,
)
from reproduction.baselines.peer import Peer
from torch_pmil.experiments.tasks.experiment import Experiment

BATCH = 64  # rows of a step, for each member
LOG_VARIANCES = -10.0, 0.5  # range of the networks' outputs, of scaled differences


class Ensemble(nn.Module):
    """E networks of two hidden layers, each of a diagonal Gaussian of O outputs.

    Args:
        members: E.
        inputs: I.
        outputs: O.
        cells: of each hidden layer.
    """

    def __init__(self, members: int, inputs: int, outputs: int, cells: int) -> None:
        super().__init__()
        sizes = [inputs, cells, cells, 2 * outputs]
        pairs = list(itertools.pairwise(sizes))
        self.weights = nn.ParameterList(
            nn.Parameter(torch.randn(members, rows, columns) / rows**0.5) for rows, columns in pairs
        )
        self.biases = nn.ParameterList(
            nn.Parameter(torch.zeros(members, 1, columns)) for _, columns in pairs
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
        members: number of networks E.
        cells: of each of their hidden layers.
        steps: of Adam in each fit.
        learning_rate: of Adam.
        weight_decay: of the networks.
        generator: of all random numbers.
    """

    def __init__(
        self,
        experiment: Experiment,
        members: int,
        cells: int,
        steps: int,
        learning_rate: float,
        weight_decay: float,
        generator: torch.Generator,
    ) -> None:
        self.experiment, self.members, self.steps = experiment, members, steps
        self.generator = generator
        D = experiment.space.dim
        inputs = len(experiment.space.feature_names) + len(experiment.actions.names)
        with seeded(generator):
            self.network = Scaled(Ensemble(members, inputs, D, cells), inputs)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=learning_rate, weight_decay=weight_decay
        )
        self.difference_std = torch.ones(D)

    def fit(self, states: Tensor, actions: Tensor, following: Tensor) -> None:
        """Go on to learn from all transitions (n, ...), each member from a sample of its own."""
        inputs = self._inputs(states.float(), to_unit(actions, self.experiment.actions))
        differences = (following - states).float()
        self.network.set_scale(inputs)
        self.difference_std = differences.std(0).clamp_min(LEAST_STD)
        targets, n = differences / self.difference_std, len(inputs)
        own = torch.randint(n, (self.members, n), generator=self.generator)

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


def minimise_by_cem(
    cost: Callable[[Tensor], Tensor],
    mean: Tensor,
    std: float,
    candidates: int,
    elites: int,
    iterations: int,
    generator: torch.Generator,
) -> Tensor:
    """The cross-entropy method: a Gaussian is fitted to the best of its draws, again and again.

    Args:
        cost: of plans (*batch, candidates, H, F) in [-1, 1], (*batch, candidates).
        mean: of the first draws, (*batch, H, F).
        std: of the first draws.
        candidates, elites: number of draws, and of the best of them.
        iterations: number of fits.
        generator: of the draws.

    Returns:
        The last mean, (*batch, H, F).

    Example:
        >>> generator = torch.Generator().manual_seed(0)
        >>> def cost(plans: Tensor) -> Tensor:
        ...     return (plans - 0.3).square().sum((-2, -1))
        >>> plan = minimise_by_cem(cost, torch.zeros(1, 2, 1), 0.5, 200, 20, 8, generator)
        >>> bool((plan - 0.3).abs().max() < 0.02)
        True
    """
    stds = torch.full_like(mean, std)
    for _ in range(iterations):
        shape = (*mean.shape[:-2], candidates, *mean.shape[-2:])
        noise = torch.randn(shape, generator=generator)
        plans = (mean.unsqueeze(-3) + stds.unsqueeze(-3) * noise).clamp(-1, 1)
        best = cost(plans).topk(elites, largest=False).indices[..., None, None]
        chosen = plans.gather(-3, best.expand(*best.shape[:-2], *plans.shape[-2:]))
        mean, stds = chosen.mean(-3), chosen.std(-3)
    return mean


class EnsembleCEM(Peer):
    """An ensemble of networks, and a planner that tracks the demonstrations.

    Args:
        experiment: what to learn.
        seed: of networks and plans.
        members: number of networks.
        cells: of each of their two hidden layers.
        steps: of Adam in each fit.
        learning_rate: of Adam.
        weight_decay: of the networks.
        plan_steps: H, how far a plan goes, or up to the end of the demonstrations.
        candidates, elites, iterations: of the cross-entropy method.
        plan_std: of its first draws, as a fraction of half the action's range.
        most_cost: c, which the cost of a step does not exceed.
    """

    label: ClassVar[str] = "network ensemble + CEM"
    name: ClassVar[str] = "ensemble_cem"

    def __init__(
        self,
        experiment: Experiment,
        seed: int,
        members: int = 5,
        cells: int = 64,
        steps: int = 500,
        learning_rate: float = 1e-3,
        weight_decay: float = 1e-4,
        plan_steps: int = 8,
        candidates: int = 64,
        elites: int = 8,
        iterations: int = 3,
        plan_std: float = 0.5,
        most_cost: float = 30.0,
    ) -> None:
        super().__init__(experiment, seed)
        self.model = EnsembleModel(
            experiment, members, cells, steps, learning_rate, weight_decay, self.generator
        )
        self.plan_steps, self.plan_std = plan_steps, plan_std
        self.candidates, self.elites, self.iterations = candidates, elites, iterations
        self.most_cost = most_cost
        demonstrated = experiment.demonstrated
        self._plan = torch.empty(0)
        self.target = demonstrated.mean.float()
        self.precision = demonstrated.cov.inverse().float()

    def fit(self) -> None:
        """Learn the model from all rollouts."""
        self.model.fit(*self.transitions)

    def act(self, step: int, states: Tensor) -> Tensor:
        """First actions of plans that go on from those of the step before."""
        ahead = min(self.plan_steps, self.experiment.horizon - step)
        F = len(self.experiment.actions.names)
        mean = torch.zeros(*states.shape[:-1], ahead, F)
        if step:
            kept = self._plan[..., 1 : ahead + 1, :]
            mean[..., : kept.shape[-2], :] = kept

        def cost(plans: Tensor) -> Tensor:
            return self.cost(step, states, plans)

        self._plan = minimise_by_cem(
            cost,
            mean,
            self.plan_std,
            self.candidates,
            self.elites,
            self.iterations,
            self.generator,
        )
        return from_unit(self._plan[..., 0, :], self.experiment.actions)

    def cost(self, step: int, states: Tensor, plans: Tensor) -> Tensor:
        """Mean cost (*batch, N) of plans (*batch, N, H, F) from states (*batch, D) at a step."""
        members, shape = self.model.members, plans.shape[:-2]
        particles = states.float().unsqueeze(-2).expand(*shape, -1).flatten(0, -2)
        particles = particles.expand(members, *particles.shape)
        actions = plans.flatten(0, -3).expand(members, -1, -1, -1)
        total = torch.zeros(particles.shape[:-1])
        for ahead in range(plans.shape[-2]):
            particles = self.model.sample(particles, actions[..., ahead, :])
            total += self.step_cost(step + ahead, particles)
        return total.mean(0).nan_to_num(torch.inf, torch.inf).reshape(shape)

    def step_cost(self, step: int, states: Tensor) -> Tensor:
        """Cost (*batch) of states (*batch, D) at the end of a step, from 0 to ``most_cost``."""
        offset = self.experiment.space.observe(states) - self.target[step]
        distance = ((offset @ self.precision[step]) * offset).sum(-1)
        return distance / (1 + distance / self.most_cost)
