"""The settings of a command line, as Hydra reads them."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType, Quote, QuotedString
from hydra.errors import HydraException

from torch_pmil.runs.settings import SettingsError, check_name, first_line

MOST_RUNS = 10_000  # of a sweep
LAUNCHER = "hydra/launcher"
# settings of a launcher, numbers and names, but not what it imports
OF_LAUNCHER = re.compile(r"hydra\.launcher\.(?!.*_target_)[\w.]+")

OF_TEXT = ("experiment", "demonstrations", "out")  # settings whose value may be a path


def as_text(word: str) -> str:
    """A word of the command line, with its value quoted if it is a path that Hydra cannot read.

    A leading ~ is the home folder. A comma separates the values of a sweep, unless it is quoted.

    Example:
        >>> as_text("out=runs/größe"), as_text("out=runs/a"), as_text("seed=ö")
        ('out="runs/größe"', 'out=runs/a', 'seed=ö')
    """
    name, _, value = word.partition("=")
    if name not in OF_TEXT or not value or value[0] in "'\"[{":
        return word
    word = f"{name}={os.path.expanduser(value)}"
    try:
        _parsed(word)
    except SettingsError:
        return word if "," in word else _quoted(word)
    return word


def check_overrides(overrides: Sequence[str], sweep: bool) -> None:
    """Raise SettingsError unless all NAME=VALUE of a command line change a known setting.

    Of Hydra's own settings, only ``hydra/launcher=NAME`` and a launcher's numbers and names can be
    set. In a ``sweep`` a setting may have several values, one for each run.

    Example:
        >>> check_overrides(["seed=range(10)", "hydra/launcher=ray"], sweep=True)
        >>> try:
        ...     check_overrides(["+sede=1"], sweep=False)
        ... except SettingsError as error:
        ...     print(error)
        there is no setting sede in +sede=1: did you mean seed?
    """
    runs = 1
    for text in overrides:
        override = _parsed(text)
        name = override.key_or_group
        if name != LAUNCHER and not OF_LAUNCHER.fullmatch(name):
            if not name:
                raise SettingsError(f"a setting must be NAME=VALUE, got {text}")
            check_name(name, text)
        if override.type in (OverrideType.ADD, OverrideType.DEL):
            raise SettingsError(f"a setting must be {name}=VALUE, got {text}")
        if override.is_sweep_override():
            if not sweep:
                raise SettingsError(
                    f"{name} must be one value, unless -m is given, got {text}{_as_one(text)}"
                )
            runs *= sum(1 for _, _ in zip(range(MOST_RUNS + 1), override.sweep_iterator()))  # noqa: B905
    if not 0 < runs <= MOST_RUNS:
        raise SettingsError(
            f"a sweep must have from 1 to {MOST_RUNS} runs, got {'none' if not runs else 'more'}"
        )


def _parsed(text: str) -> Override:
    try:
        return OverridesParser.create().parse_override(text)
    except HydraException as error:
        reason = f"{first_line(error)}{_as_one(text)}"
        raise SettingsError(f"cannot read the setting {text!r}: {reason}") from error


def _as_one(word: str) -> str:
    """How to write a word whose value is text, whatever its characters."""
    if word.partition("=")[0] not in OF_TEXT:
        return ""
    return f"; if that is its value, write {shlex.quote(_quoted(word))}"


def _quoted(word: str) -> str:
    name, _, value = word.partition("=")
    return f"{name}={QuotedString(value, Quote.double).with_quotes()}"
