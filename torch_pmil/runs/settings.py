"""What can be set on the command line, checked before anything is written."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from torch_pmil.checks import check_whole
from torch_pmil.files import FileError, LineError, read_text
from torch_pmil.runs.run_folder import (
    MOST_TRIALS,
    SEEDS,
    check_logger,
    check_resume,
)
from torch_pmil.runs.setting_words import OF_EXPERIMENT, OF_RUN, SETTINGS

OPTIONAL = ("shape", "robot", "demonstrations", "logger")  # may be null
TEXTS = ("experiment", "shape", "robot", "demonstrations", "out", "logger")
SWITCHES = ("resume", "overwrite")
REPEATED = ("experiment", "shape", "robot", "seed", "demonstrations", "trials", "logger")
FILE = "settings="  # begins the word that names a file of settings
FILE_BYTES = 2**14
MOST_LISTS = 200  # in a file: one within the other they take long to read
PLAIN = re.compile(r"(?!(null|true|false|nan|inf)$)(\.{0,2}/)?[a-z_][\w./-]*", re.IGNORECASE)


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
        changes: settings of the experiment that differ from its own, by name.

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
    changes: Mapping[str, object] = field(default_factory=dict)

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

    @property
    def repeated(self) -> dict[str, object]:
        """The settings of the run without those that say where it is written to."""
        return {name: getattr(self, name) for name in REPEATED}


NAMES = tuple(SETTINGS)


def settings_of(config: DictConfig) -> Settings:
    """The settings of a configuration.

    Raises:
        ValueError: one is missing, refers to nothing, or is not as it must be.
        ImportError: the library of the logger is missing.
    """
    missing = [name for name in OF_RUN if name not in list(config)]
    if missing:
        raise SettingsError(f"{missing[0]} must be set, got a configuration without it")
    values = {name: _value(config, name) for name in NAMES}
    changes = {name: values.pop(name) for name in OF_EXPERIMENT}
    given = {name: value for name, value in changes.items() if value is not None}
    return Settings(**values, changes=given)


def _value(config: DictConfig, name: str) -> Any:
    try:
        value = OmegaConf.select(config, name, throw_on_missing=True)
        return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
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
        _check_name(name, text)
        if override.type in (OverrideType.ADD, OverrideType.DEL):
            raise SettingsError(f"a setting must be {name}=VALUE, got {text}")
        if override.is_sweep_override() and not sweep:
            raise SettingsError(f"{name} must be one value, unless -m is given, got {text}")


def _check_name(name: str, text: str) -> None:
    if name not in NAMES:
        near = get_close_matches(name, NAMES, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(NAMES)}"
        raise SettingsError(f"there is no setting {name} in {text}: {hint}")


def word_of(name: str, value: object) -> str:
    """NAME=VALUE as the command line takes it.

    Example:
        >>> word_of("noise_std", [0.1, 0.2]), word_of("out", "runs/a"), word_of("out", "it's")
        ('noise_std=[0.1,0.2]', 'out=runs/a', "out='it\\\\'s'")
    """
    if not isinstance(value, str):
        return f"{name}={json.dumps(value, separators=(',', ':'))}"
    if PLAIN.fullmatch(value):
        return f"{name}={value}"
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"{name}='{escaped}'"


def with_file(words: Sequence[str]) -> list[str]:
    """The words of a command line with the settings of a file in place of ``settings=FILE``.

    Those that the command line gives too are left out.

    Raises:
        SettingsError: a file is named twice, or does not hold settings.
        OSError: it cannot be read.
    """
    files = [word for word in words if word.startswith(FILE)]
    if len(files) > 1:
        raise SettingsError(f"{FILE}FILE must be given once, got {' '.join(files)}")
    given = {word.partition("=")[0] for word in words}
    return [
        expanded
        for word in words
        for expanded in (_words_of_file(word, given) if word in files else [word])
    ]


def _words_of_file(word: str, given: set[str]) -> list[str]:
    path = Path(word.removeprefix(FILE)).expanduser()
    content = read_settings(path)
    return [word_of(name, value) for name, value in content.items() if name not in given]


def read_settings(path: Path) -> dict[str, object]:
    """Settings by name, of a YAML file with NAME: VALUE in each line.

    Nothing in it is executed, and it refers to nothing: neither to other entries of it nor to
    files or variables.

    Raises:
        SettingsError: it holds something else; the message says where, and what came.
        OSError: it cannot be read.
    """
    try:
        text = read_text(path, FILE_BYTES)
        _check_plain(text)
        content = OmegaConf.to_container(OmegaConf.create(text))
        if not isinstance(content, dict):
            raise SettingsError("must hold NAME: VALUE in each line, got a list")
        for name, value in content.items():
            _check_entry(str(name), value)
    except (FileError, SettingsError, OmegaConfBaseException) as error:
        raise SettingsError(f"{path}: {first_line(error)}") from error
    except (yaml.YAMLError, RecursionError, ValueError, TypeError) as error:
        raise SettingsError(f"{path}: must be YAML: {error}") from error
    return {str(name): value for name, value in content.items()}


def _check_plain(text: str) -> None:
    """Raise SettingsError at what would take long to read, or lead to other places."""
    if text.count("[") + text.count("{") > MOST_LISTS:
        raise SettingsError(f"must hold at most {MOST_LISTS} lists, got more")
    if "${" in text:
        raise SettingsError("must hold values alone, got a reference ${...}")
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text)):
        raise SettingsError("must hold values alone, got a reference *NAME")


def _check_entry(name: str, value: object) -> None:
    if isinstance(value, dict):
        raise SettingsError(
            f"{name} must be one value, got entries: write {name}.ENTRY: VALUE for each of them"
        )
    _check_name(name, f"{name}: {json.dumps(value)}")


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return str(error).strip().partition("\n")[0]
