"""A task with a cost: what is learned without a teacher, as by PILCO."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from torch import Tensor

from torch_pmil.checks import check_positive, check_positive_entries, check_tensor, check_whole
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.target_costs import Cost, check_cost
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.tasks.method import SURE, Method
from torch_pmil.tasks.task import Task

SPREAD = 400  # states
REACH = 2.0  # standard deviations of such states, in those of the first motion
SEARCH = SearchSettings(
    mean_iterations=40,
    stage_iterations=20,
    final_iterations=40,
    first_horizon=0.12,
    trust_threshold=SURE.trust_threshold,
    skip_matched_steps=False,
    restarts=2,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class CostTask(Task):
    """A task learned from a cost, without demonstrations (Deisenroth and Rasmussen 2011).

    Args:
        cost: what is minimised.
        steps: T, control steps of a motion.
        control_period: time for which the policy holds an action, s.
        centre_std: standard deviations (D,) of the states around the start at which the policy's
            centres are drawn. Angles are drawn from a whole turn. None until the first motion of a
            run has shown them.

    Raises:
        TypeError, ValueError: as :class:`Task`; or the cost is of another match space.

    Example:
        >>> from torch_pmil import load_experiment
        >>> pilco = load_experiment("double_pendulum_pilco")
        >>> pilco.cost.width, pilco.horizon
        (2.0, 25)
    """

    demonstrations: None = None  # type: ignore[assignment]
    demonstrated_states: None = None  # type: ignore[assignment]
    noise_std: float = 0.0
    method: Method = field(default_factory=lambda: Method(search=SEARCH))
    cost: Cost
    steps: int
    control_period: float
    centre_std: Tensor | None = None

    def __post_init__(self) -> None:
        check_cost(self.cost)
        object.__setattr__(self, "steps", check_whole("steps", self.steps, 1))
        period = check_positive("control_period", self.control_period)
        object.__setattr__(self, "control_period", period)
        super().__post_init__()
        if self.centre_std is not None:
            check_tensor("centre_std", self.centre_std, (self.space.dim,))
            check_positive_entries("centre_std", self.centre_std)

    @property
    def objective(self) -> type[TrajectoryLoss]:
        """Class of the loss."""
        return self.cost.objective

    @property
    def horizon(self) -> int:
        """T, number of control steps."""
        return self.steps

    @property
    def time_step(self) -> float:
        """Control period, s."""
        return self.control_period

    @property
    def settings(self) -> dict[str, object]:
        """The settings of :class:`Task`, the cost, and where the policy's centres are."""
        std = self.centre_std
        own = {"cost": self.cost.said, "centre_std": None if std is None else std.tolist()}
        return {**super().settings, **own}

    @property
    def unscaled(self) -> bool:
        """Whether the first motion must show how far the robot goes."""
        return self.centre_std is None

    def scaled_by(self, states: Tensor) -> Self:
        """The same task for a robot whose first motion is along these states, (T + 1, D)."""
        std = torch.maximum(REACH * states.std(0), self.initial.std)
        return replace(self, centre_std=std)

    def make_loss(self, policy: AnyPolicy, dynamics: ForwardModel) -> TrajectoryLoss:
        """The loss of the policy search: the expected cost."""
        return self.cost.loss(policy, dynamics, self.space, self.horizon)

    def make_policy(self, generator: torch.Generator) -> AnyPolicy:
        """A new policy: centres near random states, small random weights."""
        if self.centre_std is None:
            raise RuntimeError("a policy is made after the first motion: call scaled_by")
        states = random_states(self.space, self.initial.mean, self.centre_std, generator)
        return self.policy_near(self.space.features(states), generator)


def random_states(
    space: StateSpace, mean: Tensor, std: Tensor, generator: torch.Generator
) -> Tensor:
    """States (S, D) of uniform angles; other entries are normal with this mean and deviation."""
    white = torch.randn(SPREAD, space.dim, dtype=torch.float64, generator=generator)
    states, angles = mean + std * white, list(space.angles)
    turns = torch.rand(SPREAD, len(angles), dtype=torch.float64, generator=generator)
    states[:, angles] = (2 * turns - 1) * math.pi
    return states
