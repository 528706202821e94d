"""Saved states of a trainer's components, checked against the fresh ones before they are loaded.

The components of a new trainer show what the saved states must look like: the same entries with the
same types and shapes, and finite numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import UnionType
from typing import Any, get_args, get_type_hints

import torch
from torch import Tensor

from torch_pmil.control.policy_file import policy_of
from torch_pmil.control.tensor_file import is_whole
from torch_pmil.files import LineError, short
from torch_pmil.trainer.trials import Candidate, Trial

NUMPY_WORDS = 624  # of the state of NumPy's generator, which holds an index into them


class StateError(LineError):
    """A saved state does not fit; the message names its entry."""


def check_state(place: str, fresh: Any, saved: Any, exact: bool = True) -> None:
    """Compare a saved state with that of a fresh object of the same kind.

    Args:
        place: what the state is called in messages.
        fresh: state of a new object. None or an empty container allows any content, a list any
            number of entries like its first, a tensor without rows any number of rows, and a type,
            as ``float | None``, any such value.
        saved: state to be checked.
        exact: whether a mapping may have no entries beyond the fresh ones.

    Raises:
        StateError: they differ in entries, types or shapes, or a number is not finite.

    Example:
        >>> try:
        ...     check_state("policy", {"weights": torch.zeros(2)}, {"weights": torch.zeros(3)})
        ... except StateError as error:
        ...     print(error)
        policy.weights must be torch.float32 of shape (2,), got torch.float32 of shape (3,)
    """
    if isinstance(fresh, Tensor):
        _check_tensor(place, fresh, saved)
    elif isinstance(fresh, Mapping):
        missing = not isinstance(saved, Mapping) or fresh.keys() - saved.keys()
        if missing or (exact and fresh and saved.keys() - fresh.keys()):
            raise StateError(f"{place} must hold {_keys(fresh)}, got {_keys(saved)}")
        for key, value in fresh.items():
            check_state(f"{place}.{key}", value, saved[key], exact)
    elif isinstance(fresh, list | tuple):
        if type(saved) is not type(fresh):
            raise StateError(f"{place} must be a {type(fresh).__name__}, got {short(saved)}")
        wanted = fresh[:1] * len(saved) if isinstance(fresh, list) else fresh
        if wanted and len(saved) != len(wanted):
            raise StateError(f"{place} must hold {len(wanted)} entries, got {short(saved)}")
        for index, value in enumerate(wanted):
            check_state(f"{place}[{index}]", value, saved[index], exact)
    elif isinstance(fresh, bool | int | float | str | type | UnionType):
        kind = fresh if isinstance(fresh, type | UnionType) else type(fresh)
        if type(saved) not in (get_args(kind) or (kind,)):
            name = kind if isinstance(kind, UnionType) else kind.__name__
            raise StateError(f"{place} must be a {name}, got {short(saved)}")


def check_model(place: str, state: Mapping[str, Tensor]) -> None:
    """Raise StateError unless a model's hyper-parameters are logarithms of positive numbers."""
    for name, value in state.items():
        raw = name.rpartition(".")[2].startswith("raw_")
        if raw and not (value.exp().isfinite() & (value.exp() > 0)).all():
            found = short(value.flatten().tolist())
            raise StateError(
                f"{place}.{name} must be logarithms of positive finite numbers, got {found}"
            )


def check_run(fresh: Mapping[str, Any], saved: Mapping[str, Any], widths: tuple[int, int]) -> None:
    """Check the states of all components of a trainer.

    Args:
        fresh: states of the components of a new trainer.
        saved: those of a checkpoint.
        widths: numbers of entries of the robot's observation and of its action.

    Raises:
        StateError: a component is missing, or does not fit.
        PolicyFileError: a policy's parameters give no action.
    """
    for name, state in fresh.items():
        if name == "logger":  # may begin at any time, and may be another one
            continue
        if name not in saved:
            raise StateError(f"component {name} is missing")
        check_state(name, state, saved[name])
    _check_network(fresh["policy"], saved["policy"])
    check_model("loss_module", saved["loss_module"])
    if not 0 <= saved["rng"]["numpy"][2] <= NUMPY_WORDS:
        raise StateError(f"rng.numpy[2] must be 0 to {NUMPY_WORDS}, got {saved['rng']['numpy'][2]}")
    progress, trial = saved["trainer_module.progress"], _record(Trial)
    check_state("progress.trials", [trial], progress["trials"])
    if progress["pending"] is not None:
        check_state("progress.pending", trial, progress["pending"])
    candidate = {**_record(Candidate), "parameters": fresh["policy"]}
    check_state("progress.candidates", [candidate], progress["candidates"])
    for candidate in progress["candidates"]:
        _check_network(fresh["policy"], candidate["parameters"])
    experience, latest = saved["trainer_module.experience"], saved["collector"]["latest"]
    if experience["count"]:
        motion = _motion([experience["count"]], *widths)
        check_state("experience", motion, experience["transitions"])
    if latest is not None:
        check_state("collector.latest", {"entries": {}, "shape": [0], "cut_short": ""}, latest)
        motion = _motion(latest["shape"], *widths)
        check_state("collector.latest", motion, latest["entries"], exact=False)


def _check_network(fresh: Mapping[str, Tensor], saved: Mapping[str, Tensor]) -> None:
    """Raise PolicyFileError unless the parameters of an RBF network give actions."""
    if "centres" in fresh:  # those of a module of one's own are as finite as they were saved
        policy_of(saved, fresh["centres"].shape[-1])


def _record(kind: type) -> dict[str, Any]:
    """The types of a dataclass's fields; a float may be saved as a whole number."""
    hints = get_type_hints(kind).items()
    return {name: hint | int if hint in (float, float | None) else hint for name, hint in hints}


def _motion(shape: Sequence[int], states: int, torques: int) -> dict[str, Any]:
    """Transitions of a robot, of a batch shape, without memory for their numbers."""
    observation, action = (
        torch.zeros((), dtype=torch.float64).expand(*shape, width) for width in (states, torques)
    )
    return {"observation": observation, "action": action, "next": {"observation": observation}}


def _check_tensor(place: str, fresh: Tensor, saved: Any) -> None:
    grows = fresh.ndim > 0 and len(fresh) == 0
    same = isinstance(saved, Tensor) and saved.dtype == fresh.dtype and saved.ndim == fresh.ndim
    if not same or saved.shape[grows:] != fresh.shape[grows:]:
        wanted = (*(("n",) if grows else ()), *fresh.shape[grows:])
        found = short(saved)
        if isinstance(saved, Tensor):
            found = f"{saved.dtype} of shape {tuple(saved.shape)}"
        raise StateError(f"{place} must be {fresh.dtype} of shape {wanted}, got {found}")
    if not is_whole(saved):
        raise StateError(f"{place} must hold its numbers, got one repeated")
    finite = saved.isfinite()
    if not grows:
        finite |= saved == fresh  # bounds of a constraint may be infinite
    if not finite.all():
        raise StateError(f"{place} must be finite, got {saved[~finite][0].item()}")


def _keys(value: object) -> str:
    return ", ".join(map(str, list(value)[:20])) if isinstance(value, Mapping) else short(value)
