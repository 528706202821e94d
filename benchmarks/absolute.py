"""Choices by fixed numbers, which the package made before, for the ablation of the strangers.

See ``--variations`` of :mod:`benchmarks.strangers`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.forward_model import FitResult
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.tasks.task import Task

FAR = 3.0  # largest values of the data, in the demonstrated ones or deviations of the start
TRUSTED = 3.0  # nats a step, of however many entries


class LimitedDynamics(GPDynamics):
    """A model of the transitions whose plain features begin within limits (P,).

    Limits that leave fewer transitions than inputs count for nothing.
    """

    limits: Tensor

    def set_data(self, inputs: Tensor, targets: Tensor) -> None:
        super().set_data(*self._within(inputs, targets))

    def fit(self, inputs: Tensor, targets: Tensor, max_iterations: int = 100) -> FitResult:
        return super().fit(*self._within(inputs, targets), max_iterations)

    def _within(self, inputs: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        inside = (inputs[:, : len(self.limits)].abs() <= self.limits).all(-1)
        if inside.sum() < self.num_inputs:
            return inputs, targets
        return inputs[inside], targets[inside]


@dataclass(frozen=True)
class LimitedTask(Task):
    """A task whose model learns near what was demonstrated alone."""

    def make_dynamics(self) -> GPDynamics:
        """A forward model of the robot, without data."""
        of, D = super().make_dynamics(), self.space.dim
        tied = self.method.model.tied_lengthscales
        model = LimitedDynamics(of.num_inputs, of.num_outputs, of.targets, tied_lengthscales=tied)
        shown = FAR * self.demonstrated_states.abs().amax(0)
        limits = torch.maximum(shown, self.initial.mean.abs() + FAR * self.initial.std)
        if self.history is not None:
            past = self.history.past_actions * len(self.history.action_names)  # the last entries
            limits[D - past :] = torch.inf
        model.limits = limits[list(self.space.plain)]
        return model


@dataclass(frozen=True)
class FixedHorizons(SearchSettings):
    """Horizons that begin at five steps and grow by three, however long the motion."""

    def first_steps(self, horizon: int) -> int:
        """Smallest length of the first of the horizons up to this one, in steps."""
        return min(5, horizon)

    def more_steps(self, horizon: int) -> int:
        """Steps by which the horizon grows up to this one."""
        return 3


def with_limits(task: Task) -> Task:
    """The same task with limits of the data."""
    return LimitedTask(**{entry.name: getattr(task, entry.name) for entry in fields(Task)})


def with_fixed_criteria(task: Task) -> Task:
    """The same task with a search whose criteria were found with 25 steps of four entries."""
    entries = len(task.space.match_space.names)
    search = FixedHorizons(trust_threshold=TRUSTED / entries)
    return replace(task, method=replace(task.method, search=search))
