"""The settings of a run, checked before anything is written."""

from __future__ import annotations

import json
import os
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from torch_pmil.checks import did_you_mean
from torch_pmil.control.exploration import PDMovements
from torch_pmil.files import FileError, LineError, read_text
from torch_pmil.runs.run_folder import LOGGERS, MOST_TRIALS, check_logger, check_resume
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.target_costs import SaturatingCost
from torch_pmil.seeds import SEEDS
from torch_pmil.settings import Setting, Settings, setting
from torch_pmil.tasks.method import EndingSettings, ModelSettings, PolicySettings, RandomMotion
from torch_pmil.tasks.registry import EXPERIMENTS, is_own
from torch_pmil.tasks.targets import TargetTask

FILE = "settings="  # begins the word that names a file of settings
FILE_BYTES = 2**14
MOST_LISTS = 200  # in a file: one within the other they take long to read
PLAIN = re.compile(r"(?ai)(?!(null|true|false|nan|inf)$)(\.{0,2}/)?[a-z_][\w./-]*")
WIDTH = 100  # characters of a line of help


class SettingsError(LineError):
    """A setting is not as it must be; the message names it."""


@dataclass(frozen=True)
class RunSettings(Settings):
    """The settings of ``pmil train``; ``changes`` are those of the task and its method, by name.

    Raises:
        ValueError: a setting is of another type, or out of range.
        ImportError: the library of the logger is missing.
    """

    experiment: str = setting(
        "double_pendulum",
        "the task",
        words=f"{', '.join(EXPERIMENTS)}; or FILE.py:FUNCTION or MODULE:FUNCTION of one's own",
    )
    seed: int = setting(
        0, "of all random numbers: same seed, same run", least=SEEDS[0], most=SEEDS[1]
    )
    demonstrations: str | None = setting(
        None,
        "one's own demonstrations",
        words="a file or folder, or lasa:SHAPE; null: those that come with the task",
    )
    trials: int = setting(12, "largest number of trials", least=1, most=MOST_TRIALS, unit="trials")
    out: str = setting(
        "runs/${run_name:${experiment},${demonstrations}}/seed_${seed}",
        "folder of the run",
        words="a path",
    )
    resume: bool = setting(False, "whether to continue from the newest checkpoint in out")
    overwrite: bool = setting(False, "whether to replace the run in out if it has ended")
    logger: str | None = setting(
        "csv", "kind of TorchRL's logger", words=f"{', '.join(LOGGERS)} or null"
    )
    changes: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, declared in self.declared().items():
            if declared.kind.startswith("str"):
                _check_text(name, getattr(self, name), declared.kind.endswith("None"))
        super().__post_init__()
        check_resume(self.resume, self.overwrite)
        check_logger(self.logger)

    @property
    def folder(self) -> Path:
        """Path of the run's folder."""
        return Path(self.out)

    @property
    def repeated(self) -> dict[str, object]:
        """The settings without those that say where the run is written."""
        where = ("out", "resume", "overwrite")
        return {name: value for name, value in self.adjustable.items() if name not in where}


OF_RUN = RunSettings.declared()
OF_TASK: dict[str, Setting] = {}  # of all tasks of the package
GROUPS: list[type[Settings]] = [PolicySettings, ModelSettings, RandomMotion, EndingSettings]
GROUPS += [TargetTask, SaturatingCost, PDMovements, SearchSettings]
for group in GROUPS:
    OF_TASK |= group.declared()
SETTINGS = OF_RUN | OF_TASK


def help_lines(words: Mapping[str, str]) -> Iterator[str]:
    """Settings of a run, NAME=VALUE by name, each in words, and those that other tasks have.

    Example:
        >>> for line in list(help_lines({"resume": "resume=true"}))[:2]:
        ...     print(line)
          resume=true
              whether to continue from the newest checkpoint in out (true or false)
    """
    for name, word in words.items():
        yield f"  {word}"
        if name in SETTINGS:
            yield _indented(str(SETTINGS[name]))
    yield "\nOther experiments have some of these, as experiment=NAME --help shows:\n"
    for name, declared in SETTINGS.items():
        if name not in words:
            yield _indented(f"{name}: {declared}")


def documentation_rows() -> list[str]:
    """Rows of a table of all settings in Markdown: name, meaning, values and unit.

    Example:
        >>> print(documentation_rows()[5])
        | `resume` | whether to continue from the newest checkpoint in out | true or false |  |
    """
    return [
        f"| `{name}` | {declared.meaning} | {declared.values} | {declared.unit} |"
        for name, declared in SETTINGS.items()
    ]


def _indented(text: str) -> str:
    return textwrap.fill(text, WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 8)


def settings_of(config: DictConfig) -> RunSettings:
    """The settings of a configuration; raises ValueError if one is missing or refers to nothing."""
    missing = [name for name in OF_RUN if name not in list(config)]
    if missing:
        raise SettingsError(f"{missing[0]} must be set, got a configuration without it")
    values = {name: _value(config, name) for name in SETTINGS}
    of_run = {name: values.pop(name) for name in OF_RUN}
    given = {name: value for name, value in values.items() if value is not None}
    return RunSettings(**of_run, changes=given)


def _value(config: DictConfig, name: str) -> Any:
    try:
        value = OmegaConf.select(config, name, throw_on_missing=True)
        return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
    except OmegaConfBaseException as error:
        raise SettingsError(f"{name} cannot be read: {first_line(error)}") from error


def _check_text(name: str, value: object, optional: bool) -> None:
    if value is None and optional:
        return
    if not isinstance(value, str) or not value.strip():
        null = " or null" if optional else ""
        raise SettingsError(f"{name} must be text that is not empty{null}, got {value!r}")


def check_name(name: str, text: str) -> None:
    """Raise SettingsError if there is no setting of this name; ``text`` is where it was found."""
    if name not in SETTINGS:
        hint = did_you_mean(name, SETTINGS, f"there are {', '.join(SETTINGS)}", cutoff=0.5)
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
    """A command line in which those settings of a file that it lacks replace settings=FILE.

    Raises:
        SettingsError: a file is named twice, or does not hold settings.
        OSError: it cannot be read.
    """
    files = [word for word in words if word.startswith(FILE)]
    if len(files) > 1:
        raise SettingsError(f"{FILE}FILE must be given once, got {' '.join(files)}")
    if not files:
        return list(words)
    given, place = {word.partition("=")[0] for word in words}, words.index(files[0])
    content = read_settings(Path(os.path.expanduser(files[0].removeprefix(FILE))))
    further = [word_of(name, value) for name, value in content.items() if name not in given]
    return [*words[:place], *further, *words[place + 1 :]]


def read_settings(path: Path) -> dict[str, object]:
    """Settings by name, of a YAML file with NAME: VALUE in each line.

    Nothing in it is executed, and it cannot refer to other entries, files or variables.

    Raises:
        SettingsError: it holds something else; the message says where.
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
    check_name(name, f"{name}: {json.dumps(value)}")
    if name == "experiment" and is_own(str(value)):
        raise SettingsError(
            "experiment must be given on the command line if it is one's own, since its module is "
            f"executed: got {value}"
        )


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return str(error).strip().partition("\n")[0]
