"""What can be set on the command line, checked before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from torch_pmil.experiments.runs.run_folder import (
    MOST_TRIALS,
    SEEDS,
    check_logger,
    check_resume,
)
from torch_pmil.files import LineError
from torch_pmil.gp.checks import check_whole

OPTIONAL = ("shape", "robot", "demonstrations", "logger")  # may be null
TEXTS = ("experiment", "shape", "robot", "demonstrations", "out", "logger")
SWITCHES = ("resume", "overwrite")


class SettingsError(LineError):
    """A setting is not as it must be; the message names it."""


@dataclass(frozen=True)
class Settings:
    """The settings of ``pmil train``, of the right types and in their ranges.

    Args:
        experiment, shape, robot: the task.
        seed: of all random numbers.
        demonstrations: file with one's own; None for those that come with the package.
        trials: largest number of trials.
        out: folder of the run.
        resume: whether to go on with the run that is there.
        overwrite: whether to replace the finished run that is there.
        logger: kind of TorchRL's logger, or None.

    Raises:
        ValueError: a setting is of another type, or out of range.
        ImportError: the library of the logger is missing.
    """

    experiment: str
    shape: str | None
    robot: str | None
    seed: int
    demonstrations: str | None
    trials: int
    out: str
    resume: bool
    overwrite: bool
    logger: str | None

    def __post_init__(self) -> None:
        for name in TEXTS:
            _check_text(name, getattr(self, name))
        check_whole("seed", self.seed, *SEEDS)
        check_whole("trials", self.trials, 1, MOST_TRIALS)
        for name in SWITCHES:
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise SettingsError(f"{name} must be true or false, got {value!r}")
        check_resume(self.resume, self.overwrite)
        check_logger(self.logger)

    @property
    def folder(self) -> Path:
        """Path of the run's folder."""
        return Path(self.out)


NAMES = tuple(field.name for field in fields(Settings))


def settings_of(config: DictConfig) -> Settings:
    """The settings of a configuration.

    Raises:
        ValueError: one is missing, refers to nothing, or is not as it must be.
        ImportError: the library of the logger is missing.
    """
    return Settings(**{name: _value(config, name) for name in NAMES})


def _value(config: DictConfig, name: str) -> Any:
    if name not in list(config):
        raise SettingsError(f"{name} must be set, got a configuration without it")
    try:
        return config[name]
    except OmegaConfBaseException as error:
        raise SettingsError(f"{name} cannot be read: {first_line(error)}") from error


def _check_text(name: str, value: object) -> None:
    if value is None and name in OPTIONAL:
        return
    if not isinstance(value, str) or not value.strip():
        null = " or null" if name in OPTIONAL else ""
        raise SettingsError(f"{name} must be text that is not empty{null}, got {value!r}")


def check_overrides(overrides: Sequence[str], sweep: bool) -> None:
    """Raise SettingsError unless all NAME=VALUE of a command line change a setting that there is.

    Hydra's own (``hydra.NAME`` and ``hydra/NAME``) are left to Hydra.

    Args:
        overrides: NAME=VALUE each.
        sweep: whether a value may be several, for a run each.

    Example:
        >>> check_overrides(["seed=range(10)", "hydra/launcher=ray"], sweep=True)
        >>> try:
        ...     check_overrides(["+sede=1"], sweep=False)
        ... except SettingsError as error:
        ...     print(error)
        there is no setting sede in +sede=1: did you mean seed?
    """
    parser = OverridesParser.create()
    for text in overrides:
        try:
            override = parser.parse_override(text)
        except HydraException as error:
            raise SettingsError(f"cannot read the setting {text!r}: {first_line(error)}") from error
        name = override.key_or_group
        if name.startswith(("hydra.", "hydra/")):
            continue
        if not name:
            raise SettingsError(f"a setting must be NAME=VALUE, got {text}")
        if name not in NAMES:
            near = get_close_matches(name, NAMES, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(NAMES)}"
            raise SettingsError(f"there is no setting {name} in {text}: {hint}")
        if override.type in (OverrideType.ADD, OverrideType.DEL):
            raise SettingsError(f"a setting must be {name}=VALUE, got {text}")
        if override.is_sweep_override() and not sweep:
            raise SettingsError(f"{name} must be one value, unless -m is given, got {text}")


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return str(error).strip().partition("\n")[0]
