"""Saved states of a trainer's components, checked against the fresh ones before they are loaded.

A run's trainer is made by its experiment, so the fresh components say what the saved ones must be:
the same entries with the same types and shapes, and finite numbers where they have numbers. Where a
fresh one is empty, as the list of trials, :func:`check_run` says what may be there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from torch_pmil.control.policy_file import policy_of
from torch_pmil.control.tensor_file import is_whole
from torch_pmil.files import LineError, short
from torch_pmil.trainer.trials import Candidate, Trial

NUMPY_WORDS = 624  # of the state of NumPy's generator, of which an index goes on
EXPERIENCE = ("observation", "action", "next")


class StateError(LineError):
    """A saved state does not fit; the message names its entry."""


def check_state(place: str, fresh: Any, saved: Any) -> None:
    """Compare a saved state with that of a fresh object of the same kind.

    Args:
        place: what the state is called in messages.
        fresh: the state that the object has now. What is empty or None says nothing; a tensor
            without rows says how many columns there are.
        saved: the state that it shall have.

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
    elif isinstance(fresh, Mapping) and fresh:
        if not isinstance(saved, Mapping) or saved.keys() != fresh.keys():
            raise StateError(f"{place} must hold {_keys(fresh)}, got {_keys(saved)}")
        for key, value in fresh.items():
            check_state(f"{place}.{key}", value, saved[key])
    elif isinstance(fresh, tuple) and fresh:
        if type(saved) is not type(fresh) or len(saved) != len(fresh):
            raise StateError(f"{place} must hold {len(fresh)} entries, got {short(saved)}")
        for index, value in enumerate(fresh):
            check_state(f"{place}[{index}]", value, saved[index])
    elif isinstance(fresh, bool | int | float | str) and type(saved) is not type(fresh):
        raise StateError(f"{place} must be a {type(fresh).__name__}, got {short(saved)}")


def check_model(place: str, state: Mapping[str, Tensor]) -> None:
    """Check that a model's hyper-parameters, which are logarithms, are positive and finite.

    Raises StateError.
    """
    for name, value in state.items():
        if (
            name.rpartition(".")[2].startswith("raw_")
            and not (value.exp().isfinite() & (value.exp() > 0)).all()
        ):
            raise StateError(
                f"{place}.{name} must be logarithms of positive finite numbers, got "
                f"{short(value.flatten().tolist())}"
            )


def check_run(fresh: Mapping[str, Any], saved: Mapping[str, Any], widths: tuple[int, int]) -> None:
    """Check the states of all components of a trainer.

    Args:
        fresh: the states of the components of a new trainer.
        saved: those of a checkpoint.
        widths: numbers of entries of the robot's observation and of its action.

    Raises:
        StateError: a component is missing, or does not fit.
        PolicyFileError: a policy is none that can act.
    """
    for name, state in fresh.items():
        if name == "logger":  # may begin at any time, and may be another one
            continue
        if name not in saved:
            raise StateError(f"component {name} is missing")
        check_state(name, state, saved[name])
    inputs = fresh["policy"]["centres"].shape[-1]
    policy_of(saved["policy"], inputs)
    check_model("loss_module", saved["loss_module"])
    if not 0 <= saved["rng"]["numpy"][2] <= NUMPY_WORDS:
        raise StateError(f"rng.numpy[2] must be 0 to {NUMPY_WORDS}, got {saved['rng']['numpy'][2]}")
    _check_progress(fresh["policy"], saved["trainer_module.progress"], inputs)
    _check_motions(saved["trainer_module.experience"], saved["collector"]["latest"], *widths)


def check_motion(place: str, shape: Sequence[int], entries: Any, states: int, torques: int) -> None:
    """Check transitions of a robot: observation, action and (next, observation) of ``shape``.

    Raises StateError.
    """
    following = entries.get("next") if isinstance(entries, Mapping) else None
    if not isinstance(following, Mapping) or not {"observation", "action"} <= entries.keys():
        raise StateError(f"{place} must hold {', '.join(EXPERIENCE)}, got {_keys(entries)}")
    for name, value, width in (
        ("observation", entries["observation"], states),
        ("action", entries["action"], torques),
        ("next.observation", following.get("observation"), states),
    ):
        wanted = torch.empty((*shape, width), dtype=torch.float64, device="meta")
        _check_tensor(f"{place}.{name}", wanted, value)


def _check_motions(experience: Any, latest: Any, states: int, torques: int) -> None:
    if experience["count"]:
        count = (experience["count"],)
        check_motion("experience", count, experience["transitions"], states, torques)
    if latest is not None:
        check_state("collector.latest", {"entries": {}, "shape": [], "cut_short": ""}, latest)
        check_motion("collector.latest", latest["shape"], latest["entries"], states, torques)


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
    if not grows and not fresh.is_meta:
        finite |= saved == fresh  # bounds of a constraint may be infinite
    if not finite.all():
        raise StateError(f"{place} must be finite, got {saved[~finite][0].item()}")


def _check_progress(policy: Mapping[str, Tensor], progress: Mapping[str, Any], inputs: int) -> None:
    pending = progress["pending"]
    trials = [("pending", pending)] if pending is not None else []
    for index, trial in enumerate(_list("progress.trials", progress["trials"])):
        trials.append((f"trials[{index}]", trial))
    for name, trial in trials:
        _check_record(f"progress.{name}", Trial, trial)
    for index, candidate in enumerate(_list("progress.candidates", progress["candidates"])):
        place = f"progress.candidates[{index}]"
        _check_record(place, Candidate, candidate)
        check_state(f"{place}.parameters", policy, candidate["parameters"])
        policy_of(candidate["parameters"], inputs)


def _check_record(place: str, kind: type, record: Any) -> None:
    """Check entries against the annotations of a dataclass."""
    kinds = {field.name: str(field.type) for field in fields(kind)}
    if not isinstance(record, Mapping) or record.keys() != kinds.keys():
        raise StateError(f"{place} must hold {_keys(kinds)}, got {_keys(record)}")
    for name, wanted in kinds.items():
        found = "None" if record[name] is None else type(record[name]).__name__
        if (
            found not in wanted.split(" | ")
            and not wanted.startswith("Mapping")
            and not (found == "int" and wanted.startswith("float"))
        ):
            raise StateError(f"{place}.{name} must be a {wanted}, got {short(record[name])}")


def _list(place: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise StateError(f"{place} must be a list, got {short(value)}")
    return value


def _keys(value: object) -> str:
    return ", ".join(map(str, list(value)[:20])) if isinstance(value, Mapping) else short(value)
