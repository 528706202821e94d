"""TorchRL's optimisation step of the trainer: the policy searches of one trial."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.trainers import OptimizationStepper, Trainer

from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.search.trial_search import TrialSearch


class SearchStepper(OptimizationStepper):
    """The optimisation step of Algorithm 1: :meth:`TrialSearch.run` on the trainer's loss.

    Args:
        search: of the run's trials.
    """

    def __init__(self, search: TrialSearch) -> None:
        self.search = search

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Search from the belief p(x_0) of a batch; the policy of the loss changes in place."""
        loss, succeeded = trainer.loss_module, sub_batch["succeeded"].tolist()
        initial = Gaussian(sub_batch["observation", "mean"], sub_batch["observation", "var"])
        result = self.search.run(loss, initial, succeeded[0] if succeeded else None)
        return TensorDict({loss.out_keys[0]: torch.tensor(result.loss, dtype=torch.float64)})

    def state_dict(self) -> dict[str, Any]:
        """State of the search."""
        return self.search.state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the state of the search."""
        self.search.load_state_dict(state_dict)
