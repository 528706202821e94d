r"""Saved policies behind an extended Kalman filter, to see what a filter could bring.

The filter knows the covariance R of the readings' noise. It predicts with the robot itself, which
is the limit of any filter, or with the model that the run learned. The noise S of that model holds
that of the readings twice, at both ends of a transition. What is left is taken for process noise:
:math:`S - R - \mathrm{median}(A R A^\top)`, with the slopes A of the model at its data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from reproduction.learned import Learned, load_learned, measured_success
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.envs.mujoco_robot import MujocoRobotEnv
from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.tasks.task import Task

Successors = Callable[[Tensor, Tensor], Tensor]  # of states (N, D) and actions (N, F)
STEP = 1e-5  # of the differences, in standard deviations of the readings


def slopes(function: Successors, states: Tensor, actions: Tensor, steps: Tensor) -> Tensor:
    """Derivatives (N, D, D) of successors in their states, by central differences of ``steps``."""
    (N, D), shifts = states.shape, torch.diag(steps)
    ends = torch.stack([states[:, None] + shifts, states[:, None] - shifts])
    held = actions[:, None].expand(2, N, D, -1).flatten(0, 2)
    above, below = function(ends.flatten(0, 2), held).reshape(2, N, D, D)
    return ((above - below) / (2 * steps[:, None])).mT


@dataclass(frozen=True)
class KalmanFilter:
    """An extended Kalman filter of all N robots at once.

    Args:
        successors: mean of the next state.
        process: covariance (N, D, D) of the next state, at states (N, D) and actions (N, F).
        readings: standard deviations (D,) of the readings' noise.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> still = KalmanFilter(lambda x, u: x, lambda x, u: torch.zeros(()), readings=one)
        >>> still.updated(Gaussian(0 * one[None], one[None, None]), reading=one[None]).mean
        tensor([[0.5000]], dtype=torch.float64)
    """

    successors: Successors
    process: Successors
    readings: Tensor

    def predicted(self, belief: Gaussian, actions: Tensor) -> Gaussian:
        """Belief over the next state after these actions."""
        A = slopes(self.successors, belief.mean, actions, STEP * self.readings)
        cov = A @ belief.cov @ A.mT + self.process(belief.mean, actions)
        return Gaussian(self.successors(belief.mean, actions), symmetric(cov))

    def updated(self, belief: Gaussian, reading: Tensor) -> Gaussian:
        """Belief after readings (N, D) of the state."""
        R = torch.diag(self.readings**2)
        gain = torch.linalg.solve(belief.cov + R, belief.cov).mT
        kept = torch.eye(len(R)).to(R) - gain
        cov = kept @ belief.cov @ kept.mT + gain @ R @ gain.mT  # positive definite by its form
        mean = belief.mean + (gain @ (reading - belief.mean)[..., None])[..., 0]
        return Gaussian(mean, symmetric(cov))


class FilteredPolicy:
    """A policy that acts on what a filter estimates, in one rollout of N robots.

    Args:
        policy: of the state.
        kalman: the filter.
        start: belief over the true state before the first reading, (D,).
    """

    def __init__(self, policy: StatePolicy, kalman: KalmanFilter, start: Gaussian) -> None:
        self.policy, self.kalman, self.start = policy, kalman, start
        self._before: tuple[Gaussian, Tensor] | None = None

    def as_tensordict_module(self) -> TensorDictModule:
        """A module that reads the readings and writes the actions."""
        return TensorDictModule(self, in_keys=["observation"], out_keys=["action"])

    def __call__(self, reading: Tensor) -> Tensor:
        """Actions (N, F) after the next readings (N, D)."""
        N, D = reading.shape
        if self._before is None:
            mean, cov = self.start.mean.expand(N, D), self.start.cov.expand(N, D, D)
            belief = Gaussian(mean, cov)
        else:
            belief = self.kalman.predicted(*self._before)
        belief = self.kalman.updated(belief, reading)
        actions = self.policy(belief.mean)
        self._before = belief, actions
        return actions


@torch.no_grad()
def behind_filters(
    folder: Path, noisy: Task, plain: Task, readings: Tensor, starts: int, seed: int
) -> dict[str, float]:
    """Success of a run's saved policy from fresh starts, by what predicts in the filter.

    Args:
        folder: of the run.
        noisy: what it learned.
        plain: the same task without noise.
        readings: standard deviations (D,) of the noise.
        starts: number of rollouts.
        seed: of their starts.
    """
    learned = load_learned(folder, noisy)
    filters = {"robot": of_robot(plain.robot(seed), readings), "model": of_model(learned, readings)}
    return {
        name: measured_success(
            FilteredPolicy(learned.policy, kalman, plain.initial), noisy, starts, seed
        )
        for name, kalman in filters.items()
    }


def of_robot(env: MujocoRobotEnv, readings: Tensor) -> KalmanFilter:
    """The filter that predicts with the robot itself, without process noise."""
    return KalmanFilter(env.simulate, lambda states, actions: states.new_zeros(()), readings)


def of_model(learned: Learned, readings: Tensor) -> KalmanFilter:
    """The filter that predicts with the model of a run."""
    dynamics, space = learned.dynamics, learned.policy.space
    known = dynamics.known_part(space)

    def inputs(states: Tensor, actions: Tensor) -> Tensor:
        return torch.cat([space.features(states), actions], -1)

    def successors(states: Tensor, actions: Tensor) -> Tensor:
        return known.successors(states, actions, dynamics.mean(inputs(states, actions)))

    data, F = dynamics.train_inputs, len(learned.policy.actions.names)
    A = slopes(successors, space.states(data[:, :-F]), data[:, -F:], STEP * readings)
    through = (A * readings).square().sum(-1).median(0).values
    learned_entries = list(known.learned)
    left = dynamics.noise - (readings**2 + through)[learned_entries]

    def process(states: Tensor, actions: Tensor) -> Tensor:
        variance = dynamics.predict(inputs(states, actions))[1] + left.clamp(min=0)
        return known.gain @ torch.diag_embed(variance) @ known.gain.T

    return KalmanFilter(successors, process, readings)
