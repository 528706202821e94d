"""What peers share that learn our own forward model."""

from __future__ import annotations

from tensordict import TensorDictBase

from reproduction.baselines.peer import Peer
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.experience import Experience
from torch_pmil.tasks.task import Task

CAPACITY = 10_000  # transitions


class ModelPeer(Peer):
    """A peer with a Gaussian process as ours, which learns from all transitions as ours does.

    Args:
        experiment, seed: as for :class:`Peer`.
        dynamics: the model; that of the experiment if None.
    """

    def __init__(self, experiment: Task, seed: int, dynamics: GPDynamics | None = None) -> None:
        super().__init__(experiment, seed)
        made = experiment.make_dynamics() if dynamics is None else dynamics
        assert isinstance(made, GPDynamics)  # as a task has without a model of a user's own
        self.dynamics = made
        self.experience = Experience(CAPACITY)

    def add(self, rollout: TensorDictBase) -> None:
        """Add an own rollout (T,)."""
        super().add(rollout)
        self.experience.extend(rollout)

    def fit_model(self) -> None:
        """Fit the model to all transitions so far."""
        self.dynamics.fit(*self.experience.data_for(self.dynamics, self.experiment.space))
