"""A task with several targets: one policy that sees which (Section 5.2.5, Eq. 31)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from tensordict import TensorDictBase
from torch import Tensor

from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.demonstrations import DemonstrationError, Demonstrations
from torch_pmil.demonstrations.distribution import expert_distribution
from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.forward_model import ForwardModel
from torch_pmil.search.multi_target_loss import MultiTargetKLLoss
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.settings import setting
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.task import Task


@dataclass(frozen=True, eq=False, kw_only=True)
class TargetTask(Task):
    r"""An imitation task with a target :math:`\eta`, demonstrated for S of them.

    The demonstrations have targets (N, K), and ``demonstrated_states`` are in their order.
    ``make_env`` takes ``targets`` (num_envs, K), or (K,) for one robot, which the environment
    returns under ``"target"``. The robot that learns does every trial once for each target.

    Basis functions that are wide beside the distances of the targets make a policy that is nearly
    linear in the target, which carries over to targets between and beyond; narrow ones fit each
    target by itself.

    Raises:
        DemonstrationError: the demonstrations have no targets, or one alone.
    """

    target_scale: float = setting(
        2.5,
        "width of a new policy's basis functions in the entries of the target",
        above=0,
        unit="largest distance between two targets",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.targets) < 2:
            raise DemonstrationError(
                f"demonstrations must be of two targets at least, got {self.targets.tolist()}"
            )

    @property
    def objective(self) -> type[TrajectoryLoss]:
        """Class of the loss."""
        return MultiTargetKLLoss

    @property
    def promised(self) -> None:
        """None: success is not predicted for several targets, so confirmations alone end a run."""

    @cached_property
    def targets(self) -> Tensor:
        """The demonstrated targets, (S, K)."""
        return self._by_target[0]

    @cached_property
    def _by_target(self) -> tuple[Tensor, tuple[Demonstrations, ...]]:
        return self.demonstrations.by_target()

    @property
    def demonstrated(self) -> Gaussian:
        """Demonstrated marginals of each target at t = 1..T, mean (S, T, M), noise included."""
        each = [expert_distribution(shown, self.noise_std) for shown in self._by_target[1]]
        mean = torch.stack([marginals.mean for marginals in each])
        return Gaussian(mean, torch.stack([marginals.cov for marginals in each]))

    @property
    def settings(self) -> dict[str, object]:
        """The settings of :class:`Task`, and the targets."""
        return {**super().settings, "targets": self.targets.tolist()}

    def widths(self, std: Tensor) -> Tensor:
        """Widths (D' + K,) of a new policy's basis functions: of features, then of the target."""
        width = self.target_scale * torch.pdist(self.targets).amax()
        K = self.targets.shape[-1]
        return torch.cat([super().widths(std[:-K]), width.expand(K)])

    def robot(self, seed: int) -> MujocoRobotEnv:
        """The robot that learns, once for each target."""
        return self.robots(1, seed)

    def robots(self, starts: int, seed: int) -> MujocoRobotEnv:
        """Robots to measure a policy on, ``starts`` for the first target, then for the next."""
        return self.robots_at(self.targets.repeat_interleave(starts, 0), seed)

    def robots_at(self, targets: Tensor, seed: int) -> MujocoRobotEnv:
        """A robot for each of any targets (G, K)."""
        return self.make_env(num_envs=len(targets), targets=targets, seed=seed)

    def first_robot(self, seed: int) -> MujocoRobotEnv:
        """One robot for the first target."""
        return self.make_env(targets=self.targets[0], seed=seed)

    def outcomes(
        self, predicted: Gaussian, rollouts: TensorDictBase, errors: Tensor
    ) -> list[Outcome]:
        """As in :class:`Task`, of a prediction (S, T)."""
        demonstrated, (targets, sets) = self.demonstrated, self._by_target
        parts, measured = rollouts.chunk(len(targets)), errors.chunk(len(targets))
        outcomes = []
        for i, target in enumerate(targets):
            entries = zip(self.demonstrations.target_names, target.tolist(), strict=True)
            label = ", ".join(f"{name} = {value:g}" for name, value in entries)
            marginals = demonstrated[i], predicted[i]
            outcomes.append(Outcome(label, sets[i], *marginals, parts[i], measured[i], target))
        return outcomes

    def make_loss(self, policy: AnyPolicy, dynamics: ForwardModel) -> MultiTargetKLLoss:
        """The loss of the policy search: the mean over the targets of the KL (Eq. 31)."""
        return MultiTargetKLLoss(
            policy, dynamics, self.space, self.demonstrated, self.targets, self.noise_std
        )

    @property
    def demonstrated_inputs(self) -> Tensor:
        """Features of the demonstrated states, and their targets, (S, D' + K)."""
        targets = self.demonstrations.targets
        assert targets is not None  # or by_target had raised an error
        samples = len(self.demonstrated_states) // len(targets)
        return torch.cat([super().demonstrated_inputs, targets.repeat_interleave(samples, 0)], -1)

    def start_inputs(self, starts: Tensor) -> Tensor:
        """Features of starts (S, D), and all targets in turn, (S, D' + K)."""
        in_turn = self.targets[torch.arange(len(starts)) % len(self.targets)]
        return torch.cat([super().start_inputs(starts), in_turn], -1)
