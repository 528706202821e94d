"""Recordings of one's own: which entries are read, at which rate, and how accurate they are."""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection, Sequence
from contextlib import suppress

import torch
from torch import Tensor

from torch_pmil.control.recovered_states import rates_of
from torch_pmil.demonstrations import (
    DemonstrationError,
    Demonstrations,
    Recordings,
    load_recordings,
)
from torch_pmil.demonstrations.errors import UnknownEntryError
from torch_pmil.demonstrations.preparation.synchronisation import synchronise
from torch_pmil.demonstrations.time_unit import check_times
from torch_pmil.demonstrations.turns import values_of, with_values

NOISE = 0.05  # standard deviation of the observation noise, in demonstrated ranges of an entry
LEAST_RANGE = 0.2  # range of an entry that hardly changes, in the largest of the same unit
STILL = 0.1  # of that range; entries of unknown units that change less are warned of

Recorded = Demonstrations | Recordings | str | os.PathLike[str]


def read(
    demonstrations: Recorded, wanted: Sequence[str], control_period: float
) -> Demonstrations | Recordings:
    """Recordings of the wanted entries, with times in seconds.

    If a file lacks some of them, all its entries are read, or the wanted ones without velocities.

    Raises:
        DemonstrationError: they cannot be read, or their times are plainly not seconds.
        TypeError: they are of another kind.
    """
    recorded = demonstrations
    if isinstance(demonstrations, str | os.PathLike):
        recorded = _from_file(demonstrations, wanted)
    if not isinstance(recorded, Recordings | Demonstrations):
        raise TypeError(
            "demonstrations must be a path, Recordings or Demonstrations, got "
            f"{type(recorded).__name__}"
        )
    if isinstance(recorded, Recordings) and not recorded.in_seconds:
        check_times(recorded.times, control_period, recorded.labels)
    return recorded


def _from_file(path: str | os.PathLike[str], wanted: Sequence[str]) -> Recordings:
    with suppress(UnknownEntryError):
        return load_recordings(path, keys=wanted)
    rates = rates_of(tuple(wanted))
    unread: DemonstrationError | None = None
    try:
        every = load_recordings(path)
        if set(every.names) <= set(wanted):
            return every
    except DemonstrationError as error:
        unread = error
    with suppress(UnknownEntryError):
        places = [name for entry, name in enumerate(wanted) if entry not in rates]
        recorded = load_recordings(path, keys=places)
        if unread is None:
            _name_unused(every.names, wanted, places)
        return recorded
    if unread is not None:
        raise unread
    return every


def _name_unused(names: Sequence[str], wanted: Sequence[str], used: Sequence[str]) -> None:
    """Warn of recorded entries that are not used where velocities are wanted and have no name."""
    unused = [name for name in names if name not in used]
    missing = [name for name in wanted if name not in used]
    warnings.warn(
        f"{', '.join(unused)} of the recordings is not used, and {', '.join(missing)} follows from "
        f"the changes of {', '.join(used)}: rename the column if it is {missing[0]}",
        UserWarning,
        stacklevel=5,
    )


def with_angles(recorded: Demonstrations | Recordings) -> Demonstrations | Recordings:
    """Recordings in which each cosine and sine of an angle, "cos q" and "sin q", become "q", rad.

    Example:
        >>> shown = torch.tensor([[1.0, 0.0], [0.0, 1.0]]).double().expand(2, 2, 2)
        >>> angle = with_angles(Demonstrations(shown, 0.1, ("cos q", "sin q")))
        >>> angle.names, angle.positions[0, :, 0]
        (('q',), tensor([0.0000, 1.5708], dtype=torch.float64))
    """
    names = list(recorded.names)
    angles = [name[4:] for name in names if name[:4] == "cos " and f"sin {name[4:]}" in names]
    if not angles:
        return recorded
    kept = [name for name in names if name not in {f"sin {angle}" for angle in angles}]
    shown = tuple(name[4:] if name[4:] in angles else name for name in kept)
    values = []
    for each in values_of(recorded):
        columns = dict(zip(names, each.mT, strict=True))
        columns |= {
            f"cos {q}": torch.atan2(columns[f"sin {q}"], columns[f"cos {q}"]) for q in angles
        }
        values.append(torch.stack([columns[name] for name in kept], -1))
    units = {} if isinstance(recorded, Demonstrations) else {"units": ()}
    return with_values(recorded, values, names=shown, **units)


def at_control_rate(
    recorded: Demonstrations | Recordings, control_period: float, velocities: Collection[str]
) -> Demonstrations:
    """Recordings at the control period; those of several durations are aligned."""
    if isinstance(recorded, Demonstrations):
        return recorded
    shown = [name for name in recorded.names if name in velocities]
    return synchronise(recorded, control_period, shown)


def noise(shown: Demonstrations, units: Sequence[str]) -> Tensor:
    """Standard deviations (M,) of the observation noise.

    Raises DemonstrationError if nothing of a unit ever changes, so that no accuracy follows.
    """
    low, high = shown.positions.flatten(0, 1).aminmax(dim=0)
    span = high - low
    alike = torch.tensor([[one == other for other in units] for one in units])
    largest = (alike * span).amax(-1)  # of the same unit
    for entry in (largest == 0).nonzero().flatten().tolist():
        raise DemonstrationError(
            f"{shown.names[entry]} never changes in the demonstrations, which leaves its accuracy "
            "unknown: give noise_std"
        )
    still = STILL * LEAST_RANGE * largest > span
    for entry in [] if any(units) else still.nonzero().flatten().tolist():
        warnings.warn(
            f"{shown.names[entry]} hardly changes beside the other entries: its accuracy is "
            f"1 % of the largest range, {NOISE * LEAST_RANGE * largest[entry]:.3g}; give units "
            "if theirs differ, or noise_std",
            UserWarning,
            stacklevel=5,
        )
    return NOISE * span.maximum(LEAST_RANGE * largest)
