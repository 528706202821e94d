"""The files that a run leaves in its folder, and the origin of its results."""

from __future__ import annotations

import csv
import json
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor
from torchrl.record.loggers import CSVLogger, Logger, get_logger
from torchrl.record.loggers.mlflow import MLFlowLogger

from torch_pmil.files import (
    FileError,
    read_json,
    read_text,
    remove_temporaries,
    replacing,
    write_json,
)
from torch_pmil.runs.own_files import LIST, MOTION, check_free, files_of, own, remove_files
from torch_pmil.runs.sources import hash_of_sources
from torch_pmil.runs.summaries import RunError, is_finished, words_of
from torch_pmil.trainer.checkpoints import rotation_in, saved_checkpoints
from torch_pmil.trainer.trials import Measurement

LOGGERS = ("csv", "tensorboard", "wandb", "mlflow")
LIBRARIES = ("torch_pmil", "torch", "gpytorch", "torchrl", "tensordict", "mujoco", "numpy")

MOST_TRIALS = 1000  # memory for all their rollouts is taken at once
LOGGED = re.compile(r"(\d{1,18}),.*\n")  # a whole row of a CSV logger: step, value
STAGED = re.compile(r"\.(checkpoint-\d+\.torchrl)\.(stage|archive|backup)-[0-9a-f]{32}")


class FinishedRunError(ValueError):
    """A folder holds a run that has ended, which is replaced only if that is asked for."""


class UnfinishedRunError(ValueError):
    """A folder holds a run that was stopped, which a new one would overwrite."""


def write_origin(out: Path, source: dict[str, object]) -> None:
    """Write ``run.json``: command, date, commit and versions, before the first trial."""
    write_json(own(out, "run.json"), source)


def write_settings(out: Path, settings: Mapping[str, object]) -> None:
    """Write ``settings.yaml``, with which ``pmil train settings=FILE`` makes the run again."""
    given = settings.items()
    lines = (f"{name}: {json.dumps(value, ensure_ascii=False)}\n" for name, value in given)
    with replacing(own(out, "settings.yaml")) as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")


def read_command(folder: Path) -> list[str]:
    """The words of the command that began a run; raises RunError if ``run.json`` is damaged."""
    try:
        return words_of(read_json(folder / "run.json")["command"])
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder}: run.json is damaged: {error}") from error


def clear_folder(out: Path, overwrite: bool = False, borrowed: bool = False) -> None:
    """Remove the files of the finished run in a folder, if ``overwrite`` is true.

    Args:
        out: the folder.
        overwrite: whether to replace a run that has ended.
        borrowed: whether the new run begins with the experience of another one. Such a run is
            repeated until its first checkpoint, so that its first motion may be replaced.

    Raises:
        UnfinishedRunError: there is a run that has not ended.
        FinishedRunError: there is one that has ended, and ``overwrite`` is false.
        ForeignFileError, RunError: see :func:`~torch_pmil.runs.own_files.check_free`.
    """
    check_free(out)
    ended, experience = is_finished(out), list[str]()
    if saved_checkpoints(rotation_in(out / "checkpoints")):
        experience.append(str(out / "checkpoints" / "checkpoint-*.torchrl"))
    if (out / MOTION).exists() and not borrowed:
        experience.append(str(out / MOTION))
    if experience and not ended:
        raise UnfinishedRunError(
            f"{out} holds a run that was stopped: go on with resume=true, choose another out, or "
            f"remove {' and '.join(experience)}"
        )
    if ended and not overwrite:
        raise FinishedRunError(f"{out} holds a run that has ended: overwrite=true replaces it")
    remove_files(out)


def remove_debris(out: Path) -> None:
    """Remove what a run that was killed left of files that were not whole.

    These are beside files that the run has listed. A checkpoint that was set aside for a newer one,
    which never came, takes its place again. The caller must be alone in the folder.
    """
    for name in (LIST, *files_of(out)):
        remove_temporaries(out / name)
    for path in sorted((out / "checkpoints").glob(".*")):
        staged = STAGED.fullmatch(path.name)
        if staged is None:
            continue
        if staged[2] == "backup" and not path.with_name(staged[1]).exists():
            path.rename(path.with_name(staged[1]))
        elif path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def check_logger(kind: str | None) -> None:
    """Raise ValueError unless there is such a logger, ImportError if its library is missing."""
    if kind not in (None, *LOGGERS):
        raise ValueError(f"logger must be one of {', '.join(LOGGERS)} or null, got {kind}")
    if kind not in (None, "csv") and find_spec(kind) is None:
        raise ImportError(f"logger={kind} needs another library: pip install {kind}")


def check_resume(resume: bool, overwrite: bool) -> None:
    """Raise ValueError if a run is both to be continued and to be replaced."""
    if resume and overwrite:
        raise ValueError(
            "resume=true goes on with a run, and overwrite=true replaces it: give one of the two"
        )


class ListedCSVLogger(CSVLogger):
    """TorchRL's logger of CSV files, which lists each file of a run before it makes it."""

    def __init__(self, out: Path, name: str) -> None:
        super().__init__(name, str((out / "logs").absolute()))
        self._out, self._scalars = out, f"logs/{name}/scalars"

    @property
    def listed(self) -> list[Path]:
        """The files that are there."""
        own_ones = (self._out / name for name in files_of(self._out))
        folder = self._out / self._scalars
        return [path for path in own_ones if path.is_relative_to(folder) and path.exists()]

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        """Append a number to the file of its name."""
        own(self._out, f"{self._scalars}/{name}.csv")
        super().log_scalar(name, value, step)


def open_logger(kind: str, out: Path, experiment: str, seed: int) -> Logger:
    """TorchRL's logger of that kind for a run; raises ImportError where its library is missing.

    MLflow refuses the folder that TorchRL suggests; it gets the server of ``MLFLOW_TRACKING_URI``,
    or a database in ``logs/``.
    """
    name, folder = f"{experiment}_seed_{seed}", (out / "logs").absolute()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        if kind == "mlflow":
            server = os.environ.get("MLFLOW_TRACKING_URI", f"sqlite:///{folder / 'mlflow.db'}")
            return MLFlowLogger(name, tracking_uri=server)
        if kind == "csv":
            return ListedCSVLogger(out, name)
        return get_logger(kind, str(folder), name)
    except ImportError as error:
        raise ImportError(f"logger={kind} needs another library: pip install {kind}") from error


def rewind_logs(logger: Logger | None, step: int) -> None:
    """Let the files of a CSV logger end with a step, after which a resumed run logs again.

    Raises RunError if a file was not written by a logger.
    """
    if not isinstance(logger, ListedCSVLogger):
        return
    for file in logger.experiment.files.values():
        file.close()
    logger.experiment.files.clear()  # which are opened again
    for path in logger.listed:
        try:
            rows = map(LOGGED.fullmatch, read_text(path).splitlines(keepends=True))
        except FileError as error:
            raise RunError(f"{path}: {error}") from error
        kept = [row[0] for row in rows if row and int(row[1]) <= step]
        if kept:
            with replacing(path) as temporary:
                temporary.write_text("".join(kept))
        else:
            path.unlink()


def write_metrics(path: Path, kind: type[Measurement], trials: Sequence[Measurement]) -> None:
    """Write a row for each trial, with a column for each field of that kind of trial."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(kind)])
        writer.writeheader()
        writer.writerows(asdict(trial) for trial in trials)


def save_tensors(path: Path, tensors: dict[str, Tensor]) -> None:
    """Save a state dict that ``torch.load(path, weights_only=True)`` reads."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        torch.save(tensors, file)  # a path would be written into it


def provenance(command: str) -> dict[str, object]:
    """Command, date, versions, hash of the package, and commit, "unknown" outside a source tree."""
    describe, here = ["git", "describe", "--always", "--dirty"], Path(__file__).parent
    try:
        git = subprocess.run(describe, cwd=here, capture_output=True, text=True, check=False)
        commit = git.stdout.strip() or "unknown"
    except OSError:
        commit = "unknown"
    versions = {"python": platform.python_version()}
    versions |= {name: version(name) for name in LIBRARIES}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "command": command,
        "date": date,
        "commit": commit,
        "sources": hash_of_sources(),
        "versions": versions,
    }
