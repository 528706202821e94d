"""The cost of a trajectory and its gradient in the policy, without a graph.

What does not change in a search, such as the model and what is compared, is packed once.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.model.compiled.arrays import NetworkGradient
from torch_pmil.model.compiled.costs import CostWork, write_costs, write_costs_of_means
from torch_pmil.model.compiled.packing import (
    array,
    determinants_of,
    mean_of,
    observation_of,
    robots_of,
    roots_of,
)
from torch_pmil.model.compiled.plans import Comparison, Parameters, Plan
from torch_pmil.model.compiled.sampled_trajectory import (
    ParticleTape,
    ParticleWork,
    follow,
    roll_back,
)
from torch_pmil.model.compiled.trajectory import Robot, StepWork, Tape, predict
from torch_pmil.model.compiled.trajectory_adjoint import Cotangents, adjoint


class PolicyObjective:
    """Sum of the costs of T steps from one belief, as a function of a policy's parameters.

    Args:
        plan: of the prediction.
        comparison: what the states are compared with.
        start: p(x_0), mean (D,).
        scale: of the policy's inputs, (D',).
        mean_alone: whether the trajectory is that of the model's mean.
    """

    def __init__(
        self, plan: Plan, comparison: Comparison, start: Gaussian, scale: Tensor, mean_alone: bool
    ) -> None:
        (robot,) = robots_of(plan, plan.controller.parameters, 1)
        self.network, self.scale = robot.network, array(scale)
        self.gradient = NetworkGradient.zero(robot.network)
        of_trajectory = CostsOfMeans if mean_alone else CostsOfBeliefs
        self.costs = of_trajectory(robot, comparison, start, plan.horizon)

    # a line search may try widths whose squares are no numbers: the optimiser sees that by itself
    @np.errstate(over="ignore", divide="ignore", invalid="ignore")
    def __call__(self, parameters: Parameters) -> tuple[float, Parameters] | None:
        """The sum and its gradients; None where the formulas must say what is wrong."""
        inputs, weights, squares = self.network[:3]
        centres, of_centres, widths = map(array, (*parameters[:2], parameters[2].exp()))
        m, scaled = len(centres), widths * self.scale
        inputs[:, :m] = (centres * self.scale).T
        weights[:, :m] = of_centres.T
        squares[:] = np.square(scaled)
        for each in self.gradient:
            each.fill(0.0)
        costs = self.costs(self.gradient)
        if costs is None or not np.isfinite(costs).all():
            return None
        of_inputs, of_weights, of_squares = self.gradient
        gradients = (
            torch.from_numpy(of_inputs[:, :m].T * self.scale),
            torch.from_numpy(of_weights[:, :m].T.copy()),
            torch.from_numpy(2 * scaled * of_squares * self.scale * widths),
        )
        return torch.from_numpy(costs).sum().item(), gradients


class CostsOfBeliefs:
    """Costs of predicted marginals."""

    def __init__(self, robot: Robot, comparison: Comparison, start: Gaussian, T: int) -> None:
        D, self.robot = len(start.mean), robot
        self.tape, self.work = Tape.of(robot, T), StepWork.of(robot)
        self.tape.mean[0], self.tape.cov[0] = array(start.mean), array(symmetric(start.cov))
        self.observation = observation_of(comparison, (T,))
        self.demonstrated = *determinants_of(comparison, (T,)), comparison.cross_entropy
        self.cost_work = CostWork.of(self.observation)
        self.out = np.empty(T), np.empty((T, D)), np.empty((T, D, D))
        self.back, self.of_start = Cotangents.of(robot), (np.empty(D), np.empty((D, D)))

    def __call__(self, gradient: NetworkGradient) -> np.ndarray | None:
        """Costs (T,), whose gradient in the network is added; None if they cannot be computed."""
        tape, (costs, d_mean, d_cov) = self.tape, self.out
        if predict(self.robot, tape, self.work):
            return None
        if not (np.isfinite(tape.mean).all() and np.isfinite(tape.cov).all()):
            return None
        of_states = tape.mean[1:], tape.cov[1:], self.cost_work
        if write_costs(self.observation, *self.demonstrated, *of_states, *self.out):
            return None
        d_cov = array(symmetric(torch.from_numpy(d_cov)))
        works = self.work, self.back
        adjoint(self.robot, tape, d_mean, d_cov, *works, *self.of_start, gradient)
        return costs


class CostsOfMeans:
    """Costs of the states of the model's mean."""

    def __init__(self, robot: Robot, comparison: Comparison, start: Gaussian, T: int) -> None:
        D, self.robot = len(start.mean), robot
        self.mean, self.noise = mean_of(robot.model), np.zeros((1, T, robot.gain.shape[1]))
        self.tape, self.work = ParticleTape.of(robot, 1, T), ParticleWork.of(robot, self.mean)
        self.tape.states[0, 0] = array(start.mean)
        self.observation, self.roots = observation_of(comparison, (T,)), roots_of(comparison, (T,))
        self.saturating = comparison.demonstrated is None
        self.cost_work = CostWork.of(self.observation)
        self.out = np.empty(T), np.empty((T, D))
        self.unbounded, self.of_start = np.zeros(D), np.empty((1, D))

    def __call__(self, gradient: NetworkGradient) -> np.ndarray:
        """As in :class:`CostsOfBeliefs`; they are always computed."""
        costs, d_states = self.out
        follow(self.robot, self.mean, self.noise, self.tape, self.work)
        of_costs = self.tape.states[0, 1:], self.saturating, self.cost_work
        write_costs_of_means(self.observation, self.roots, *of_costs, *self.out)
        sweep = self.tape, d_states[None], self.unbounded, self.work
        roll_back(self.robot, *sweep, self.of_start, gradient)
        return costs
