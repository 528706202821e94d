r"""An ensemble of probabilistic networks, and a planner that tracks the demonstrations with it.

The cross-entropy method finds the plan of least cost under the ensemble's E particles, the first
action of the plan is executed, and it is planned anew.

.. math:: \min_{u_{t..t+H-1}} \frac{1}{E} \sum_e \sum_{k=t+1}^{t+H}
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

from typing import ClassVar

import torch
from torch import Tensor

from reproduction.baselines.cross_entropy_method import minimise_by_cem
from reproduction.baselines.network_ensemble import MEMBERS, EnsembleModel
from reproduction.baselines.networks import from_unit
from reproduction.baselines.peer import Peer
from torch_pmil.tasks.task import Task

PLAN_STD = 0.5  # of a plan's first draws, as a fraction of half the action's range
LARGE_PLANNER = {"candidates": 256, "elites": 26, "iterations": 5}  # for precise plans


class EnsembleCEM(Peer):
    """An ensemble of networks, and a planner that tracks the demonstrations.

    Args:
        experiment: what to learn.
        seed: of networks and plans.
        steps: of Adam in each fit.
        learning_rate: of Adam.
        plan_seconds: how far a plan goes, or up to the end of the demonstrations.
        candidates, elites, iterations: of the cross-entropy method.
        most_cost: c, which the cost of a step does not exceed.
    """

    label: ClassVar[str] = "network ensemble + CEM"
    name: ClassVar[str] = "ensemble_cem"

    def __init__(
        self,
        experiment: Task,
        seed: int,
        steps: int = 2500,
        learning_rate: float = 2e-3,
        plan_seconds: float = 0.8,
        candidates: int = 64,
        elites: int = 8,
        iterations: int = 3,
        most_cost: float = 30.0,
    ) -> None:
        super().__init__(experiment, seed)
        self.model = EnsembleModel(experiment, steps, learning_rate, self.generator)
        self.plan_steps = round(plan_seconds / experiment.demonstrations.time_step)
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
            PLAN_STD,
            self.candidates,
            self.elites,
            self.iterations,
            self.generator,
        )
        return from_unit(self._plan[..., 0, :], self.experiment.actions)

    def cost(self, step: int, states: Tensor, plans: Tensor) -> Tensor:
        """Mean cost (*batch, N) of plans (*batch, N, H, F) from states (*batch, D) at a step."""
        shape = plans.shape[:-2]
        particles = states.float().unsqueeze(-2).expand(*shape, -1).flatten(0, -2)
        particles = particles.expand(MEMBERS, *particles.shape)
        actions = plans.flatten(0, -3).expand(MEMBERS, -1, -1, -1)
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
