"""Checkpoints of a learning run: one archive after every rollout, checked before it is read.

An archive is either whole or not there.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import torch
from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation, GlobalRNGState

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


def new_checkpoint() -> Checkpoint:
    """An archive whose parts have checksums, with the global random generators in it."""
    return Checkpoint(format="archive", rng=GlobalRNGState())


def rotation_in(folder: Path | str) -> CheckpointRotation:
    """Rotation that keeps the newest checkpoints of a run in this folder."""
    return CheckpointRotation(folder, keep_last=KEPT)


def saved_checkpoints(rotation: CheckpointRotation) -> list[Path]:
    """All archives of a rotation, the newest first, undamaged or not."""
    return sorted(rotation.directory.glob(f"{rotation.prefix}-*.torchrl"), reverse=True)


def newest_undamaged(rotation: CheckpointRotation) -> Path | None:
    """The newest checkpoint of which every byte can be read, or None if there is no checkpoint.

    There is a warning for each newer, damaged one.

    Raises:
        CheckpointError: there are checkpoints, and all are damaged.
    """
    paths = saved_checkpoints(rotation)
    for path in paths:
        problem = damage(path)
        if problem is None:
            return path
        warnings.warn(
            f"checkpoint {path} is damaged ({problem}): the one before it is taken",
            RuntimeWarning,
            stacklevel=2,
        )
    if paths:
        raise CheckpointError(f"all checkpoints in {rotation.directory} are damaged")
    return None


def damage(path: Path) -> str | None:
    """Description of what is wrong with a checkpoint's file, or None."""
    try:
        with ZipFile(path) as archive:
            broken = archive.testzip()
        Checkpoint.manifest(path)
    except (BadZipFile, CheckpointError, OSError, ValueError, NotImplementedError) as error:
        return str(error)
    return None if broken is None else f"{broken} fails its checksum"
