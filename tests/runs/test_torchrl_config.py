"""``trainer=pmil`` beside TorchRL's own configurations."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.errors import ConfigCompositionException
from hydra.utils import instantiate
from omegaconf import DictConfig
from torchrl.record.loggers import CSVLogger

from tests.helpers.short_run import quick_fits, short_experiment
from torch_pmil.runs.torchrl_config import PMILTrainerConfig
from torch_pmil.tasks.registry import EXPERIMENTS
from torch_pmil.trainer.trainer import PMILTrainer

CONFIG = """
defaults:
  - trainer: pmil
  - logger: csv
  - _self_
logger:
  exp_name: run
  log_dir: {folder}
trainer:
  logger: ${{logger}}
  checkpoint_rotation:
    _target_: torchrl.checkpoint.CheckpointRotation
    directory: {folder}/checkpoints
    keep_last: 2
  trials: 1
  progress_bar: false
"""


@pytest.fixture
def config(tmp_path: Path) -> Iterator[DictConfig]:
    (tmp_path / "main.yaml").write_text(CONFIG.format(folder=tmp_path))
    with initialize_config_dir(str(tmp_path), version_base="1.3"):
        yield compose("main", overrides=["trainer.seed=7"])


def test_settings_are_those_of_the_config_store(config: DictConfig) -> None:
    assert config.trainer._target_ == PMILTrainerConfig._target_
    assert (config.trainer.experiment, config.trainer.seed, config.trainer.trials) == (
        "double_pendulum",
        7,
        1,
    )


def test_instantiated_trainer_learns_logs_and_saves(
    config: DictConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    short = short_experiment()
    monkeypatch.setitem(EXPERIMENTS, "double_pendulum", lambda demonstrations: short)
    trainer = instantiate(config.trainer)
    assert isinstance(trainer, PMILTrainer) and isinstance(trainer.logger, CSVLogger)
    trainer.train()
    assert len(trainer.trials) == 1
    scalars = {path.stem for path in (tmp_path / "run" / "scalars").glob("*.csv")}
    assert {
        "trial",
        "experience_s",
        "success_rate",
        "loss",
        "own_error",
        "own_success",
        "loss_kl",
        "search_seconds",
    } <= scalars
    assert len(list((tmp_path / "checkpoints").glob("*.torchrl"))) == 2


def test_unknown_setting_is_refused_by_hydra(tmp_path: Path) -> None:
    (tmp_path / "main.yaml").write_text("defaults: [{trainer: pmil}]\n")
    with (
        initialize_config_dir(str(tmp_path), version_base="1.3"),
        pytest.raises(ConfigCompositionException, match=r"Could not override 'trainer\.trails'"),
    ):
        compose("main", overrides=["trainer.trails=3"])
