"""The files that a run leaves in its folder, and the origin of its results."""

from __future__ import annotations

import csv
import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import torch
from torch import Tensor
from torchrl.record.loggers import Logger, get_logger
from torchrl.record.loggers.mlflow import MLFlowLogger

from torch_pmil.experiments.runs.summaries import RunError
from torch_pmil.files import read_json, replacing, write_json
from torch_pmil.trainer.checkpoints import rotation_in, saved_checkpoints
from torch_pmil.trainer.trials import Measurement

LOGGERS = ("csv", "tensorboard", "wandb", "mlflow")
LIBRARIES = ("torch_pmil", "torch", "gpytorch", "torchrl", "tensordict", "mujoco", "numpy")


class UnfinishedRunError(ValueError):
    """A folder holds a run that was stopped, which a new one would overwrite."""


def prepare_folder(out: Path) -> None:
    """Make the folder of a run, with ``figures/``; raise OSError if it cannot be written to."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    with replacing(out / ".writable") as probe:
        probe.touch()
    (out / ".writable").unlink()


def write_origin(out: Path, source: dict[str, object]) -> None:
    """Write ``run.json``: command, date, commit and versions, from the run's first second on."""
    write_json(out / "run.json", source)


def read_command(folder: Path) -> str:
    """The command that began a run.

    Raises:
        RunError: ``run.json`` is damaged.
        OSError: the folder has none.
    """
    try:
        return str(read_json(folder / "run.json")["command"])
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: run.json is damaged: {error}") from error


def clear_folder(out: Path) -> None:
    """Remove the checkpoints, logs and pictures of a finished run.

    Raises UnfinishedRunError where the last run has not ended.
    """
    saved = saved_checkpoints(rotation_in(out / "checkpoints"))
    if saved and not (out / "summary.json").exists():
        raise UnfinishedRunError(
            f"{out} holds a run that was stopped: go on with resume=true, or remove "
            f"{out / 'checkpoints'}"
        )
    for leftover in (out / "checkpoints", out / "logs", out / "figures"):
        if leftover.exists():
            shutil.rmtree(leftover)
    for leftover in (out / "video.mp4", out / "video.gif", out / "report.html"):
        leftover.unlink(missing_ok=True)


def open_logger(kind: str, out: Path, experiment: str, seed: int) -> Logger:
    """TorchRL's logger of that kind for a run; raises ImportError where its library is missing.

    MLflow's server is that of ``MLFLOW_TRACKING_URI``, or else a database in ``logs/``: it refuses
    the folder that TorchRL suggests.
    """
    name, folder = f"{experiment}_seed_{seed}", (out / "logs").absolute()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        if kind == "mlflow":
            database = f"sqlite:///{folder / 'mlflow.db'}"
            server = os.environ.get("MLFLOW_TRACKING_URI", database)
            return MLFlowLogger(name, tracking_uri=server)
        return get_logger(kind, str(folder), name)
    except ImportError as error:
        raise ImportError(f"logger={kind} needs another library: pip install {kind}") from error


def write_metrics(path: Path, kind: type[Measurement], trials: Sequence[Measurement]) -> None:
    """Write a row for each trial, with a column for each field of that kind of trial."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(kind)])
        writer.writeheader()
        writer.writerows(asdict(trial) for trial in trials)


def save_tensors(path: Path, tensors: dict[str, Tensor]) -> None:
    """Save a state dict that ``torch.load(path, weights_only=True)`` reads."""
    with replacing(path) as temporary:
        torch.save(tensors, temporary)


def check_whole(name: str, value: int, least: int) -> None:
    """Raise ValueError unless a setting is a whole number of at least ``least``."""
    if not isinstance(value, int) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")


def provenance(command: str) -> dict[str, object]:
    """Provenance of a result: command, date, commit and versions.

    The commit is that of the source tree, "unknown" outside one.

    The commit is that of the source tree, "unknown" outside one.
    """
    try:
        git = subprocess.run(
            ["git", "describe", "--always", "--dirty"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=False,
        )
        commit = git.stdout.strip() or "unknown"
    except OSError:
        commit = "unknown"
    versions = {"python": platform.python_version()}
    versions |= {name: version(name) for name in LIBRARIES}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return {"command": command, "date": date, "commit": commit, "versions": versions}
