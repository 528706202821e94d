"""PILCO, the baseline of Section 5.1.1: a cost in place of the demonstrations."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import torch
from torch import Tensor

from torch_pmil.checks import check_tensor
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.search.losses import ExpectedSaturatingCost
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.settings import setting
from torch_pmil.tasks.double_pendulum import UPRIGHT, double_pendulum
from torch_pmil.tasks.task import Task

COST_WIDTH = 2.0  # m, Eq. 28
VELOCITY_STD = 3.0  # rad/s
SPREAD = 400  # states
SEARCH = SearchSettings(
    mean_iterations=40,
    stage_iterations=20,
    final_iterations=40,
    first_horizon=0.12,
    trust_threshold=0.025,
    skip_matched_steps=False,
    restarts=2,
)


@dataclass(frozen=True, eq=False)
class PilcoTask(Task):
    """A task learned from the expected saturating cost of not being at a target (Eq. 28).

    Demonstrations only give the number of steps, and are drawn beside the prediction. The policy's
    centres are spread over the state space.

    Example:
        >>> pilco = double_pendulum_pilco()
        >>> pilco.target
        tensor([0.0000, 0.5000, 0.0000, 1.0000], dtype=torch.float64)
    """

    objective: ClassVar[type[TrajectoryLoss]] = ExpectedSaturatingCost

    target: Tensor = setting(
        None,
        "where the cost of PILCO is zero",
        "Tensor",
        words="numbers, one for each entry of the match space",
        unit="the unit of the entry",
    )
    cost_width: float = setting(
        COST_WIDTH,
        "distance from the target at which the cost of PILCO saturates",
        above=0,
        unit="the unit of the entries",
    )
    velocity_std: float = setting(
        VELOCITY_STD,
        "standard deviation of the velocities at the centres of PILCO's new policy",
        above=0,
        unit="rad/s",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tensor("target", self.target, (self.space.match_space.dim,))

    def make_loss(self, policy: RBFPolicy, dynamics: GPDynamics) -> ExpectedSaturatingCost:
        """The loss of the policy search: the expected cost of not being at the target."""
        return ExpectedSaturatingCost(
            policy, dynamics, self.space, self.target, self.cost_width, self.horizon
        )

    def make_policy(self, generator: torch.Generator) -> RBFPolicy:
        """A new policy: centres near random states, small random weights."""
        states = random_states(self.space, self.velocity_std, generator)
        return self.policy_near(self.space.features(states), generator)


def random_states(space: StateSpace, velocity_std: float, generator: torch.Generator) -> Tensor:
    """States (S, D) of uniform angles and of normal velocities with this standard deviation."""
    states = velocity_std * torch.randn(SPREAD, space.dim, dtype=torch.float64, generator=generator)
    angles = list(space.angles)
    turns = torch.rand(SPREAD, len(angles), dtype=torch.float64, generator=generator)
    states[:, angles] = (2 * turns - 1) * math.pi
    return states


def double_pendulum_pilco(demonstrations: Demonstrations | None = None) -> PilcoTask:
    """The swing-up of Section 5.1 by PILCO; arguments and errors as in :func:`double_pendulum`."""
    task = double_pendulum(demonstrations)
    same = {entry.name: getattr(task, entry.name) for entry in fields(task)}
    own = {"name": "double_pendulum_pilco", "method": replace(task.method, search=SEARCH)}
    return PilcoTask(**(same | own), target=torch.tensor(UPRIGHT, dtype=torch.float64))
