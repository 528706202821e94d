"""The trainer in TorchRL's Hydra configuration, as ``trainer=pmil``.

It is there after ``import torch_pmil.runs.torchrl_config``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hydra.core.config_store import ConfigStore
from torchrl.checkpoint import CheckpointRotation
from torchrl.record.loggers import Logger
from torchrl.trainers import TrainerHookBase
from torchrl.trainers.algorithms.configs.trainers import TrainerConfig

from torch_pmil.demonstrations import load_demonstrations
from torch_pmil.runs.training import make_trainer
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.trainer.trainer import PMILTrainer


@dataclass
class PMILTrainerConfig(TrainerConfig):
    """Settings of :class:`PMILTrainer` on an experiment.

    Args:
        experiment: name of the task.
        demonstrations: NPZ or CSV file with one's own; None for those that come with the package.
        shape, robot: of handwriting; None for all others.
        seed: of all random numbers.
        trials: largest number of trials.
        progress_bar: whether to show progress.
        logger: a logger of TorchRL's, ``logger=csv`` for one.
        checkpoint_rotation: where checkpoints go.
        hooks: TorchRL's trainer hooks, registered in this order.
    """

    experiment: str = "double_pendulum"
    demonstrations: str | None = None
    shape: str | None = None
    robot: str | None = None
    seed: int = 0
    trials: int = 12
    progress_bar: bool = True
    logger: Any = None
    checkpoint_rotation: Any = None
    hooks: list[Any] | None = None

    _target_: str = "torch_pmil.runs.torchrl_config.make_pmil_trainer"


def make_pmil_trainer(
    experiment: str,
    demonstrations: str | None,
    shape: str | None,
    robot: str | None,
    seed: int,
    trials: int,
    progress_bar: bool,
    logger: Logger | None,
    checkpoint_rotation: CheckpointRotation | None,
    hooks: list[TrainerHookBase] | None,
) -> PMILTrainer:
    """The trainer that ``hydra.utils.instantiate`` makes of a :class:`PMILTrainerConfig`."""
    task = load_experiment(
        experiment,
        None if demonstrations is None else load_demonstrations(demonstrations),
        shape,
        robot,
    )
    trainer = make_trainer(
        task, seed, trials, progress_bar, lambda trial: None, logger, checkpoint_rotation
    )
    for hook in hooks or []:
        hook.register(trainer)
    return trainer


ConfigStore.instance().store(group="trainer", name="pmil", node=PMILTrainerConfig)
