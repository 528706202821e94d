"""Settings: each is declared once, as a field with its meaning, range and unit.

Checks, ``pmil train --help``, the settings file, the report and the documentation read them here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from torch_pmil.checks import LARGEST, check_whole, plain
from torch_pmil.files import short


@dataclass(frozen=True)
class Setting:
    """What a setting means and which values it takes.

    Args:
        meaning: in words.
        kind: annotation of its field.
        unit: of its numbers, "" if they have none.
        words: the values in words; derived from kind and bounds if empty.
        least, above, most: bounds of its numbers, included but for ``above``.
    """

    meaning: str
    kind: str
    unit: str = ""
    words: str = ""
    least: float | None = None
    above: float | None = None
    most: float | None = None

    @property
    def values(self) -> str:
        """The values that it takes, in words.

        Example:
            >>> Setting("basis functions", "int", least=1).values
            'whole number, at least 1'
        """
        if self.kind == "bool":
            return "true or false"
        parts = [self.words] if self.words else []
        parts += ["whole number"] if self.kind == "int" else []
        bounds = (self.above, self.least, self.most)
        for word, bound in zip(("above", "at least", "at most"), bounds, strict=True):
            if bound is not None:
                number = str(int(bound)) if bound == int(bound) else f"{bound:g}"
                parts.append(f"{word} {number}")
        return ", ".join(parts)

    def __str__(self) -> str:
        unit = f"; unit: {self.unit}" if self.unit else ""
        return f"{self.meaning} ({self.values}{unit})"

    def check(self, name: str, value: object) -> None:
        """Raise ValueError unless a value is of the kind and within the bounds."""
        if self.kind == "bool" and not isinstance(value, bool):
            raise ValueError(f"{name} must be true or false, got {short(value)}")
        if self.kind == "int":
            most = None if self.most is None else int(self.most)
            check_whole(name, value, int(self.least or 0), most)
        if self.kind == "float" and not self._holds(value):
            raise ValueError(f"{name} must be a finite number, {self.values}, got {value!r}")
        numbers = value.flatten().tolist() if isinstance(value, Tensor) else []
        if self.kind.startswith("Tensor") and not all(map(self._holds, numbers)):
            raise ValueError(f"{name} must be {self.values}, got {short(numbers)}")

    def _holds(self, number: object) -> bool:
        """Whether this is a finite number within the bounds."""
        if not isinstance(number, int | float) or isinstance(number, bool):
            return False
        return (
            abs(number) <= LARGEST  # not NaN either
            and (self.least is None or number >= self.least)
            and (self.above is None or number > self.above)
            and (self.most is None or number <= self.most)
        )


def setting(default: Any, meaning: str, kind: str = "", **words: Any) -> Any:
    """A field of :class:`Settings`, declared in words.

    Args:
        default: its value; ``...`` if it must be given.
        meaning, words: arguments of :class:`Setting`.
        kind: of its values, where the field's annotation is wider.
    """
    metadata = {"meaning": meaning, "kind": kind, **words}
    return field(metadata=metadata) if default is ... else field(default=default, metadata=metadata)


class Settings:
    """A dataclass whose fields are settings, or groups of settings.

    ``prefix`` begins the names of its settings, each of which is a field by :func:`setting`.

    Raises:
        ValueError: a setting is of another type, or out of range.

    Example:
        >>> @dataclass(frozen=True)
        ... class Walk(Settings):
        ...     steps: int = setting(3, "steps of the walk", least=1)
        >>> Walk().with_settings(steps=5)
        Walk(steps=5)
        >>> Walk(steps=0)
        Traceback (most recent call last):
        ValueError: steps must be a whole number of at least 1, got 0
    """

    prefix: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for name, declared in self.declared().items():
            of_field = name.removeprefix(self.prefix)
            object.__setattr__(self, of_field, plain(getattr(self, of_field)))
            declared.check(name, getattr(self, of_field))

    @classmethod
    def declared(cls) -> dict[str, Setting]:
        """Its own settings by their full names, without those of groups."""
        return {
            f"{cls.prefix}{entry.name}": Setting(
                **{**entry.metadata, "kind": entry.metadata["kind"] or _kind(entry.type)}
            )
            for entry in fields(cls)  # type: ignore[arg-type]
            if "meaning" in entry.metadata
        }

    @property
    def adjustable(self) -> dict[str, object]:
        """All settings, those of groups too: full names and values, in types that JSON has."""
        values: dict[str, object] = {}
        for name in self.declared():
            value = getattr(self, name.removeprefix(self.prefix))
            values[name] = value.tolist() if isinstance(value, Tensor) else value
        for group in self._own_groups().values():
            values |= group.adjustable
        return values

    def with_settings(self, **changes: object) -> Self:
        """A copy with other settings, by their full names.

        Args:
            changes: numbers, lists of them, true and false; a whole group by its field's name.

        Raises:
            TypeError: a group is not Settings.
            ValueError: there is no such setting, or one is of another type, shape or range.

        Example:
            >>> from torch_pmil import load_experiment
            >>> changes = {"noise_std": 0.1, "search.final_iterations": 60}
            >>> task = load_experiment("double_pendulum").with_settings(**changes)
            >>> task.noise_std, task.method.search.final_iterations
            (0.1, 60)
        """
        known = [*self.adjustable, *self.groups()]
        for name in changes:
            if name not in known:
                owner = getattr(self, "name", type(self).__name__)
                listed = ", ".join(self.adjustable)
                raise ValueError(f"a setting of {owner} must be one of {listed}, got {name}")
        return self._with(changes)

    def _with(self, changes: Mapping[str, object]) -> Self:
        own: dict[str, Any] = {
            name.removeprefix(self.prefix): _read(name, changes[name], declared.kind)
            for name, declared in self.declared().items()
            if name in changes
        }
        for name, group in self._own_groups().items():
            other = changes.get(name, group)
            if not isinstance(other, Settings):
                raise TypeError(f"{name} must be Settings, got {type(other).__name__}")
            if (changed := other._with(changes)) is not group:
                own[name] = changed
        return replace(self, **own) if own else self  # type: ignore[type-var]

    def _own_groups(self) -> dict[str, Settings]:
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in values.items() if isinstance(value, Settings)}

    def groups(self) -> list[str]:
        """Names of all groups, those within groups too."""
        own = self._own_groups()
        return [*own, *(name for group in own.values() for name in group.groups())]


def _kind(annotation: object) -> str:
    """An annotation as text, whether or not it was evaluated."""
    text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    return text.replace("torch.", "")


def _read(name: str, value: object, kind: str) -> object:
    """A value as a tensor, if its field holds nothing else or the value is a list."""
    if "Tensor" not in kind or ("float" in kind and not isinstance(value, list | tuple)):
        return value
    if value is None:
        return None
    try:
        return torch.as_tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise ValueError(f"{name} must be numbers, got {short(value)}") from error
