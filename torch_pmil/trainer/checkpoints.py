"""Checkpoints of a learning run: one archive after every rollout, checked before it is read.

An archive is either whole or not there.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation, GlobalRNGState

from torch_pmil.trainer.archive import SavedRun, read_archive

KEPT = 2  # number of checkpoints of a run that are kept


class GeneratorState:
    """A random generator with the state methods that a checkpoint needs."""

    def __init__(self, generator: torch.Generator) -> None:
        self.generator = generator

    def state_dict(self) -> dict[str, torch.Tensor]:
        """The present state of the generator."""
        return {"state": self.generator.get_state()}

    def load_state_dict(self, state_dict: Mapping[str, torch.Tensor]) -> None:
        """Set the generator to a saved state."""
        self.generator.set_state(state_dict["state"])


class RunRotation(CheckpointRotation):
    """TorchRL's rotation, which opens no file but a checkpoint: others stay and do not count.

    ``metadata`` stands in the manifest of every checkpoint.
    """

    metadata: Mapping[str, object] | None = None

    def save(self, checkpoint: Checkpoint, *, step: int, **options: Any) -> Path:
        """Save a checkpoint with the metadata of the run."""
        return super().save(checkpoint, step=step, metadata=self.metadata, **options)

    def prune(self) -> tuple[Path, ...]:
        """Remove all undamaged checkpoints but the newest ones; return what was removed."""
        undamaged = [path for path in saved_checkpoints(self) if _read(path)[0]]
        removed = undamaged[self.keep_last :]
        for path in removed:
            path.unlink()
        return tuple(removed)


def new_checkpoint() -> Checkpoint:
    """An archive whose parts have checksums, with the global random generators in it."""
    return Checkpoint(format="archive", rng=GlobalRNGState())


def rotation_in(folder: Path | str, metadata: Mapping[str, object] | None = None) -> RunRotation:
    """Rotation that keeps the newest checkpoints of a run in this folder.

    Args:
        folder: of the checkpoints.
        metadata: entries about the run for each manifest, in types that JSON has.
    """
    rotation = RunRotation(folder, keep_last=KEPT)
    rotation.metadata = metadata
    return rotation


def saved_checkpoints(rotation: CheckpointRotation) -> list[Path]:
    """All archives of a rotation, the newest first, undamaged or not."""
    return sorted(rotation.directory.glob(f"{rotation.prefix}-*.torchrl"), reverse=True)


def newest_undamaged(rotation: CheckpointRotation, before: Path | None = None) -> SavedRun | None:
    """The newest checkpoint that holds what a trainer writes, or None if there is no checkpoint.

    There is a warning for each newer, damaged one.

    Args:
        rotation: of the checkpoints.
        before: one of them, than which it is older; None for none.

    Raises:
        CheckpointError: there are such checkpoints, and all are damaged.
    """
    paths = [path for path in saved_checkpoints(rotation) if before is None or path < before]
    for path in paths:
        saved, problem = _read(path)
        if saved is not None:
            return saved
        warnings.warn(
            f"checkpoint {path} is damaged ({problem}): the one before it is taken",
            RuntimeWarning,
            stacklevel=2,
        )
    if paths:
        raise CheckpointError(f"all checkpoints in {rotation.directory} are damaged")
    return None


def discard_newest(rotation: CheckpointRotation) -> SavedRun | None:
    """Remove the newest checkpoint, as if its rollout had never been; return the one before it.

    None is returned where that was the first rollout, or there was none. Where the one before is
    no longer there, nothing is removed, with a warning, and the newest is returned.

    Raises:
        CheckpointError: the ones before are damaged.
    """
    paths = saved_checkpoints(rotation)
    if not paths:
        return None
    before = newest_undamaged(rotation, before=paths[0])
    if before is None and _rollouts_before(paths[0]) > 0:
        warnings.warn(
            "the rollout stays: of those before it, no checkpoint is left to go back to",
            RuntimeWarning,
            stacklevel=2,
        )
        return newest_undamaged(rotation)
    paths[0].unlink()
    return before


def _rollouts_before(path: Path) -> int:
    """Number of rollouts before the one that a checkpoint holds."""
    return int(path.stem.rpartition("-")[2])


def _read(path: Path) -> tuple[SavedRun | None, str]:
    """What a checkpoint holds, or None and what is wrong with it."""
    try:
        return read_archive(path), ""
    except (CheckpointError, OSError) as error:
        return None, str(error)
