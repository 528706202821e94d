"""The problem that a trainer solves: a robot, an objective with policy and model, a success."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from torch_pmil.checks import check_positive
from torch_pmil.control.exploration import Exploration
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_box import StateBox
from torch_pmil.envs.guards import Guard
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.rollout import check_start_belief
from torch_pmil.search.trajectory_loss import TrajectoryLoss


@dataclass(frozen=True, eq=False)
class Problem:
    """What is learned, on which robot, and which rollout is a success.

    Args:
        env: a single robot; for a policy of targets, one robot for each target, which it gives
            under ``"target"``.
        loss: the objective, with policy and model.
        initial: p(x_0).
        error: maps rollouts (*batch, T) of the environment to their errors, (*batch).
        tolerance: largest error of a success.
        make_policy: returns a new random policy, drawn from a generator.
        exploration: how the robot moves before anything is learned.
        measured: a batch of robots on which every policy is measured from fresh starts; None for a
            robot that makes no motion but its own rollouts.
        box: limits of the motion. ``env`` stops where it leaves them, the exploration begins small
            (:class:`~torch_pmil.control.exploration.CautiousMotion`), and a policy that is
            likely to leave them is refused, or runs for its first steps alone
            (:func:`~torch_pmil.search.admission.admit`).
        fall: why a motion of ``env`` must end at states (*batch, D), within the box too; "" if it
            goes on.

    Raises:
        TypeError: an environment is of another kind.
        ValueError: the tolerance is negative, or the start is not over the state.
    """

    env: EnvBase
    loss: TrajectoryLoss
    initial: Gaussian
    error: Callable[[TensorDictBase], Tensor]
    tolerance: float
    make_policy: Callable[[torch.Generator], AnyPolicy]
    exploration: Exploration
    measured: EnvBase | None = None
    box: StateBox | None = None
    fall: Guard | None = None

    def __post_init__(self) -> None:
        tolerance = check_positive("tolerance", self.tolerance, zero=True)
        object.__setattr__(self, "tolerance", tolerance)
        for name in ("env", "measured"):
            env = getattr(self, name)
            if not isinstance(env, EnvBase) and not (name == "measured" and env is None):
                raise TypeError(f"{name} must be an EnvBase, got {type(env).__name__}")
        check_start_belief(self.initial, "initial", self.loss.dynamics, self.loss.space)

    @property
    def guards(self) -> tuple[Guard | None, ...]:
        """What ends a motion of ``env``: the limits of the box, and a fall."""
        return None if self.box is None else self.box.guard, self.fall

    def frames(self, trials: int) -> int:
        """Number of transitions of a run with that many trials, if no rollout is cut short."""
        steps = self.exploration.rollouts * self.exploration.steps + trials * self.loss.horizon
        return self.env.batch_size.numel() * steps
