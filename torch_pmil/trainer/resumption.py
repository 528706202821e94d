"""A run goes on from a checkpoint that fits it: all of it is checked, then all of it is loaded."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from torchrl.checkpoint import CheckpointError, CheckpointRotation

from torch_pmil.files import bounded_line
from torch_pmil.trainer.archive import SavedRun
from torch_pmil.trainer.checkpoints import newest_undamaged
from torch_pmil.trainer.state_checks import check_run


def restore(
    components: Mapping[str, Any],
    saved: SavedRun,
    rotation: CheckpointRotation | None,
    widths: tuple[int, int],
) -> SavedRun:
    """Load a checkpoint into a trainer's components, or the one before it if it does not fit.

    The one before is taken if it is of the same run, with a warning.

    Args:
        components: by name, with state methods.
        saved: the checkpoint.
        rotation: where older ones are; None for nowhere.
        widths: numbers of entries of the robot's observation and of its action.

    Returns:
        The checkpoint that was loaded.

    Raises:
        CheckpointError: none fits; the message is of the first.
    """
    fitting = _newest_that_fits(components, saved, rotation, widths)
    for name in sorted(components.keys() & fitting.states.keys()):
        try:
            components[name].load_state_dict(fitting.states[name])
        except Exception as error:  # parts of TorchRL fail at other states with any type
            raise CheckpointError(
                f"checkpoint {fitting.path}: component {name} does not fit: {bounded_line(error)}"
            ) from error
    return fitting


def _newest_that_fits(
    components: Mapping[str, Any],
    saved: SavedRun,
    rotation: CheckpointRotation | None,
    widths: tuple[int, int],
) -> SavedRun:
    fresh = {name: part.state_dict() for name, part in components.items()}
    try:
        check_run(fresh, saved.states, widths)
    except (ValueError, TypeError, LookupError, RuntimeError) as error:
        failure = CheckpointError(f"checkpoint {saved.path}: {bounded_line(error)}")
        older = _one_before(saved, rotation)
        if older is None:
            raise failure from error
        warnings.warn(f"{failure}: the one before it is taken", RuntimeWarning, stacklevel=2)
        return _newest_that_fits(components, older, rotation, widths)
    return saved


def _one_before(saved: SavedRun, rotation: CheckpointRotation | None) -> SavedRun | None:
    """The undamaged checkpoint of the same run before one, or None."""
    if rotation is None:
        return None
    with suppress(CheckpointError):  # all of those are damaged
        older = newest_undamaged(rotation, before=saved.path)
        if older is not None and older.metadata == saved.metadata:
            return older
    return None
