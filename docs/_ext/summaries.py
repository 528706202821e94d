"""Numbers and tables of the pages, filled in from ``results/**/summary.json``.

A number is a replacement field of Python. ``{hit_rate:.0%}`` is an entry of the ``headline``,
``{counts/all/totals/trials}`` one below others. ``{runs/experience_s:.1f}`` is the range over a
list, ``{runs/seed=3/experience_s:.1f}`` that over the members with this seed, and
``{lower..upper:.0%}`` that between two entries.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from datetime import datetime
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any

from torch_pmil.runs.sources import hash_of_sources

RESULTS = Path(__file__).parents[2] / "results"
TABLE = re.compile(r"^```\{results\} (\S+)\n((?::.*\n)*)((?:[^`:].*\n)*)```$", re.MULTILINE)
NUMBER = re.compile(r"\{result\}`(\S+)\s+([^`]+)`")
FIGURE = re.compile(r"results/([\w/]+)/\w+\.(?:png|gif)")


def path_of(name: str) -> Path:
    """The file of the results with a name such as ``paper/box``."""
    return RESULTS / name / "summary.json"


@cache
def summary_of(name: str) -> dict[str, Any]:
    """The content of that file."""
    return json.loads(path_of(name).read_text())


def entry(summary: dict[str, Any], path: str) -> Any:
    """An entry of the headline, or one with a path; below a list, that of each member."""
    if path in summary.get("headline", {}):
        return summary["headline"][path]
    found: Any = summary
    for name in path.split("/"):
        if not isinstance(found, list):
            found = found[name]
        elif "=" in name:
            key, _, value = name.partition("=")
            found = [member for member in found if str(member[key]) == value]
        elif name.isdigit():
            found = found[int(name)]
        else:
            found = [member[name] for member in found]
    if found == []:
        raise KeyError(path)
    return found


class _Fields(Formatter):
    """Formats entries: ``null`` as "never", a list as its range."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> tuple[Any, str]:
        found = [entry(kwargs, name) for name in field_name.split("..")]
        return (found if len(found) > 1 else found[0]), field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            return "never"
        if isinstance(value, list):
            low, high = (self.format_field(end, format_spec) for end in (min(value), max(value)))
            return low if low == high else f"{low.removesuffix(' %')} to {high}"
        return format(value, format_spec).replace("%", " %").replace("-", "−")


def fill(name: str, template: str) -> str:
    """A text with the numbers of a summary in place of its fields."""
    return _Fields().vformat(template, (), summary_of(name))


def table(source: str, lines: Sequence[str], rows: str = "", columns: str = "") -> list[list[str]]:
    """The cells of a table, its header first. A cell is empty if the summary lacks an entry of it.

    Args:
        source: name of the summary.
        lines: ``label: template`` for each row; with " | " between the templates of the columns if
            they differ. With ``rows`` alone the lines are the columns. With ``rows`` and
            ``columns`` the one line is the template of all cells.
        rows, columns: keys, each as ``key`` or ``key = label``, with " | " between them. A key
            takes the place of ``<row>`` or ``<column>`` in the templates and in ``source``.

    Raises:
        ValueError: a row or column would be empty.
    """
    keys, place = _keys(columns or rows), "<column>" if columns else "<row>"
    if rows and columns:
        lines = [f"{label}: {lines[0].replace('<row>', key)}" for key, label in _keys(rows)]
    cells = [["", *(label for _, label in keys)]]
    for line in lines:
        label, _, text = line.partition(": ")
        texts = text.split(" | ") if " | " in text else [text] * len(keys)
        pairs = zip(keys, texts, strict=True)
        filled = [_cell(source.replace(place, k), t.replace(place, k)) for (k, _), t in pairs]
        cells.append([label, *filled])
    turned = [list(column) for column in zip(*cells, strict=True)]
    empty = [line[0] for line in (*cells[1:], *turned[1:]) if not any(line[1:])]
    if empty:
        raise ValueError(f"{source} has no entries for {empty}")
    return turned if rows and not columns else cells


def sources(source: str, rows: str = "", columns: str = "") -> list[str]:
    """The names of the summaries of a table."""
    place = "<column>" if columns else "<row>"
    return list(dict.fromkeys(source.replace(place, key) for key, _ in _keys(columns or rows)))


def options(text: str) -> dict[str, str]:
    """The options of a table from its lines, as ``:rows: 25 | 50``."""
    return dict(re.findall(r"^:(\w+): (.*)$", text, re.MULTILINE))


def quoted(text: str) -> list[str]:
    """Names of the summaries of a page's tables and numbers, and of those beside its figures."""
    names = [
        name
        for source, given, _ in TABLE.findall(text)
        for name in sources(source, **options(given))
    ]
    names += [name for name, _ in NUMBER.findall(text)]
    names += [name for name in FIGURE.findall(text) if path_of(name).exists()]
    return sorted(dict.fromkeys(names))


def note_of_older(text: str) -> str:
    """What a page says in its end of the results that it quotes and earlier sources made."""
    older = [f"`results/{name}`" for name in quoted(text) if is_older(name)]
    return (
        f"Of earlier sources on this page (`make evidence`): {', '.join(older)}." if older else ""
    )


def _keys(text: str) -> list[tuple[str, str]]:
    parts = [part.partition(" = ") for part in text.split(" | ")]
    return [(key, label or key) for key, _, label in parts]


def _cell(name: str, template: str) -> str:
    try:
        return fill(name, template)
    except KeyError:
        return ""


def provenance(name: str) -> str:
    """By how many runs, when and with which version and commits a summary was made."""
    summary = summary_of(name)
    runs = [run for run in summary.get("runs", []) if "commit" in run]
    times = [datetime.fromisoformat(run.get("date", summary["date"])) for run in runs or [summary]]
    commits = list(dict.fromkeys(run["commit"] for run in runs or [summary]))
    more = f" and {len(commits) - 2} more" if len(commits) > 2 else ""
    parts = [
        *([f"{len(runs)} runs"] if len(runs) > 1 else []),
        f"{min(times):%Y-%m-%d}",
        f"torch_pmil {summary['versions']['torch_pmil']}",
        f"commit{'s' if len(commits) > 1 else ''} {', '.join(commits[:2])}{more}",
    ]
    mark = " **Of earlier sources.**" if is_older(name) else ""
    return f"`results/{name}/summary.json`: {', '.join(parts)}.{mark}"


def is_older(name: str) -> bool:
    """Whether other sources than the present made a summary, or one of its runs."""
    summary = summary_of(name)
    runs = [run["sources"] for run in summary.get("runs", []) if "sources" in run]
    return {summary.get("sources"), *runs} != {hash_of_sources()}
