r"""Search on trajectories that each follow a function drawn from the model's posterior.

Early in a run the prediction by moments can be trusted for a few steps only, and a search over a
growing horizon lets the robot tumble after them. Samples of functions stay apart instead of
blurring, so that the whole horizon can be searched at once. Their cost rises with the logarithm of
the distance from the demonstrations: far trajectories still pull, but do not drown the near ones.

The gradient is that of pathwise derivatives, with a bound for each particle. It is noisy, so that
L-BFGS is unfit for it: Adam takes its steps (Kingma and Ba 2015).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.gp.lbfgs import MinimiseResult
from torch_pmil.model.sampled_rollouts import (
    follow_functions,
    noise_of_steps,
    sample_consistent_rollouts,
)
from torch_pmil.search.policy_search import SearchResult, SearchRuns
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.seeds import draw_seed

PARTICLES = 50  # of each step of Adam
REDRAWN = 10  # steps after which particles follow other functions
RATE, LAST_RATE = 0.03, 0.003  # of Adam, at first and at last; parameters are of order one
JUDGES = 200  # particles by which policies are compared
# predicted success rate from which it counts: the model of early trials errs by more
PROMISING = 0.5


def search_on_samples(
    loss: TrajectoryLoss, initial: Gaussian, steps: int, generator: torch.Generator
) -> MinimiseResult:
    """Lower the mean cost of sampled trajectories over the whole horizon by Adam.

    Args:
        loss: objective with the policy (changed in place) and the model.
        initial: p(x_0).
        steps: of Adam, each on particles with starts and noise drawn anew.
        generator: seeded source of the draws.
    """
    parameters = [each for each in loss.actor_network.parameters() if each.requires_grad]
    adam = torch.optim.Adam(parameters, lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps, LAST_RATE)
    start, units, costs = loss.begin(initial)[0], _units(loss, initial, generator), list[float]()
    for step in range(steps):
        if step % REDRAWN == 0:
            functions = loss.dynamics.functions(PARTICLES, generator)
        starts = start.sample(PARTICLES, generator)
        noise = noise_of_steps(loss.dynamics, (*starts.shape[:-1], loss.horizon), generator)
        given = loss.begin(initial)[1], functions, loss.dynamics, loss.space, noise, units
        states = torch.cat([starts[..., None, :], follow_functions(starts, *given)], -2)
        cost = mean_cost(loss, states)
        costs.append(cost.item())
        gradients = torch.autograd.grad(cost, parameters, allow_unused=True, materialize_grads=True)
        if not all(gradient.isfinite().all() for gradient in gradients):
            return MinimiseResult(costs[0], costs[-1], step, step + 1, 1, "numerical failure")
        for parameter, gradient in zip(parameters, gradients, strict=True):
            parameter.grad = gradient
        adam.step()
        schedule.step()
    adam.zero_grad()
    return MinimiseResult(costs[0], costs[-1], steps, steps, 0, "iteration limit")


@torch.no_grad()
def _units(loss: TrajectoryLoss, initial: Gaussian, generator: torch.Generator) -> Tensor:
    """Units (D,) in which the gradient of a particle is bounded, from the spread of all states.

    If one state moves by that spread, the mean cost over N particles changes by at most 1 / N of
    :meth:`TrajectoryLoss.typical_cost`.
    """
    states = _rollouts(loss, initial, PARTICLES, generator)
    spread = states[..., 0, 0].numel() * states.flatten(0, -2).std(0)
    return spread / loss.typical_cost(states)


def _rollouts(
    loss: TrajectoryLoss, initial: Gaussian, count: int, generator: torch.Generator
) -> Tensor:
    """States at t = 0..T, (count, *batch, T + 1, D), of particles under the loss's policy."""
    start, policy = loss.begin(initial)
    functions = loss.dynamics.functions(count, generator)
    given = functions, count, loss.dynamics, loss.space, loss.horizon, generator
    return sample_consistent_rollouts(start, policy, *given)


def mean_cost(loss: TrajectoryLoss, states: Tensor) -> Tensor:
    r"""Mean over trajectories (N, \*batch, T + 1, D) of the sum of their costs."""
    return loss.sample_costs(states).sum(-1).mean()


@torch.no_grad()
def expected_cost(loss: TrajectoryLoss, initial: Gaussian, seed: int) -> float:
    """Cost of a policy by particles, to be compared with that of others of the same seed."""
    states = _rollouts(loss, initial, JUDGES, torch.Generator().manual_seed(seed))
    cost = mean_cost(loss, states).item()
    return cost if math.isfinite(cost) else math.inf


class Judgement(NamedTuple):
    """What samples say of a policy: its predicted success rate and its expected cost."""

    rate: float
    cost: float

    @property
    def merit(self) -> tuple[float, float]:
        """By what policies are compared: first a promising rate, then the cost."""
        return self.rate if self.rate >= PROMISING else 0.0, -self.cost


class SampleSearches:
    """Searches on samples; the policy before the first of them is a candidate too.

    Adam may leave a good policy for a worse one. All are judged on the same samples.

    Args:
        runs: of the optimiser, to which the searches are added; its loss holds the policy.
        steps: of Adam, in each search.
        generator: seeded source of all draws.
        rate: predicts the success rate of the present policy.
    """

    def __init__(
        self,
        runs: SearchRuns,
        steps: int,
        generator: torch.Generator,
        rate: Callable[[], float],
    ) -> None:
        self.runs, self.steps, self.generator, self.rate = runs, steps, generator, rate
        self._seed = draw_seed(generator)
        self._found = [self._judged()]

    def search(self) -> Judgement:
        """Search from the present policy, and judge the one that is found."""
        add_search_on_samples(self.runs, self.steps, self.generator)
        self._found.append(self._judged())
        return self._found[-1][0]

    def best(self) -> SearchResult:
        """Outcome of all searches, with the best policy in the loss."""
        _, parameters = max(self._found, key=lambda each: each[0].merit)
        self.runs.loss.actor_network.load_state_dict(parameters)
        return self.runs.result(self.runs.loss.horizon)

    def _judged(self) -> tuple[Judgement, dict[str, Tensor]]:
        loss, initial = self.runs.loss, self.runs.initial
        judgement = Judgement(self.rate(), expected_cost(loss, initial, self._seed))
        return judgement, copy.deepcopy(loss.actor_network.state_dict())


def add_search_on_samples(runs: SearchRuns, steps: int, generator: torch.Generator) -> None:
    """Search on samples from the present policy, as one of the runs of the optimiser."""
    runs.runs.append(search_on_samples(runs.loss, runs.initial, steps, generator))
    runs.report("samples", runs.runs[-1].loss)
