"""Checkpoints of a learning run: one archive after every rollout, either whole or not there.

An archive is checked before it is loaded, and none of it is executed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation, GlobalRNGState

from torch_pmil.control.tensor_file import load_archive
from torch_pmil.files import FileError, bounded_line
from torch_pmil.trainer.state_checks import check_run

KEPT = 2  # number of checkpoints of a run that are kept


@dataclass(frozen=True, eq=False)
class SavedRun:
    """The content of an undamaged checkpoint.

    Args:
        path: of its archive.
        metadata: entries about the run.
        states: state dictionary of each component.
    """

    path: Path
    metadata: dict[str, Any]
    states: dict[str, Any]


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

    ``metadata`` stands in the manifest of every checkpoint; ``announce`` is called with the name of
    each before it is written.
    """

    metadata: Mapping[str, object] | None = None
    announce: Callable[[str], object] = staticmethod(lambda name: None)

    def save(self, checkpoint: Checkpoint, *, step: int, **options: Any) -> Path:
        """Save a checkpoint with the metadata of the run."""
        self.announce(self._checkpoint_path(step, checkpoint.format).name)
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
    """All archives of a rotation, newest first, even damaged ones, but no copies by other names."""
    numbered = f"{rotation.prefix}-{12 * '[0-9]'}.torchrl"
    return sorted(rotation.directory.glob(numbered), reverse=True)


def read_checkpoint(path: Path) -> SavedRun:
    """A checkpoint from its archive; raise CheckpointError or OSError if it cannot be read."""
    try:
        return SavedRun(path, *load_archive(path))
    except FileError as error:
        raise CheckpointError(str(error)) from error


def newest_undamaged(rotation: CheckpointRotation, before: Path | None = None) -> SavedRun | None:
    """The newest undamaged checkpoint, or None if there is no checkpoint.

    Each newer, damaged one gives a warning.

    Args:
        rotation: of the checkpoints.
        before: a checkpoint; only older ones are considered. None for all.

    Raises:
        CheckpointError: there are such checkpoints, and all are damaged.
    """
    paths = [path for path in saved_checkpoints(rotation) if before is None or path < before]
    for path in paths:
        saved, problem = _read(path)
        if saved is not None:
            return saved
        message = f"checkpoint {path} is damaged ({problem}): the one before it is taken"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    if paths:
        raise CheckpointError(f"all checkpoints in {rotation.directory} are damaged")
    return None


def discard_newest(rotation: CheckpointRotation) -> SavedRun | None:
    """Remove the newest checkpoint, and so its rollout, and return the one before it.

    Returns None if there was no earlier rollout. If the earlier checkpoint is missing, the newest
    is kept and returned, with a warning.

    Raises:
        CheckpointError: the ones before are damaged.
    """
    paths = saved_checkpoints(rotation)
    if not paths:
        return None
    before = newest_undamaged(rotation, before=paths[0])
    rollouts_before = int(paths[0].stem.rpartition("-")[2])
    if before is None and rollouts_before > 0:
        message = "the rollout stays: of those before it, no checkpoint is left to go back to"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
        return newest_undamaged(rotation)
    paths[0].unlink()
    return before


def restore(
    components: Mapping[str, Any],
    saved: SavedRun,
    rotation: CheckpointRotation | None,
    widths: tuple[int, int],
) -> SavedRun:
    """Load a checkpoint into a trainer's components: all of it is checked, then all is loaded.

    If it does not fit, the one before it is taken with a warning, provided it is of the same run.

    Args:
        components: by name, with state methods.
        saved: the checkpoint.
        rotation: of the older ones; None if there are none.
        widths: numbers of entries of the robot's observation and of its action.

    Returns:
        The checkpoint that was loaded.

    Raises:
        CheckpointError: no checkpoint fits; the message is that of the given one.
    """
    fresh = {name: part.state_dict() for name, part in components.items()}
    first = None
    while problem := _misfit(fresh, saved, widths):
        first, older = first or problem, _one_before(saved, rotation)
        if older is None:
            raise first
        warnings.warn(f"{problem}: the one before it is taken", RuntimeWarning, stacklevel=2)
        saved = older
    for name in sorted(components.keys() & saved.states.keys()):
        try:
            components[name].load_state_dict(saved.states[name])
        except Exception as error:  # parts of TorchRL fail at other states with any type
            raise CheckpointError(
                f"checkpoint {saved.path}: component {name} does not fit: {bounded_line(error)}"
            ) from error
    return saved


def _misfit(
    fresh: Mapping[str, Any], saved: SavedRun, widths: tuple[int, int]
) -> CheckpointError | None:
    """What does not fit in a checkpoint, if anything does not."""
    try:
        check_run(fresh, saved.states, widths)
    except (ValueError, TypeError, LookupError, RuntimeError) as error:
        return CheckpointError(f"checkpoint {saved.path}: {bounded_line(error)}")
    return None


def _one_before(saved: SavedRun, rotation: CheckpointRotation | None) -> SavedRun | None:
    """The undamaged checkpoint of the same run before one, or None."""
    if rotation is None:
        return None
    with suppress(CheckpointError):  # all of those are damaged
        older = newest_undamaged(rotation, before=saved.path)
        if older is not None and older.metadata == saved.metadata:
            return older
    return None


def _read(path: Path) -> tuple[SavedRun | None, str]:
    """The content of a checkpoint, or None and what is wrong with it."""
    try:
        return read_checkpoint(path), ""
    except (CheckpointError, OSError) as error:
        return None, str(error)
