"""The page of results and the README quote what the reproduction wrote, and nothing else."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
TASKS = {path.name for path in (ROOT / "results" / "tasks").iterdir()}  # by make results
PAGE = ROOT / "docs" / "results" / "results.md"
README = ROOT / "README.md"
# | value unit | `NAME/entry` |
VALUE_AND_ENTRY = re.compile(r"\| ([\d.]+)( %)?[^|`\n]*\| `(\w+)/([\w.]+)` (?=\|)")


def quoted(page: Path) -> list[tuple[str, ...]]:
    return VALUE_AND_ENTRY.findall(page.read_text())


@cache
def summary_of(name: str) -> dict:
    """The results of that name, whichever folder of results holds them."""
    (path,) = (ROOT / "results").glob(f"*/{name}/summary.json")
    return json.loads(path.read_text())


def as_told(value: float, told: str, percent: str) -> str:
    """A value with as many decimals as the page gives it."""
    decimals = len(told.partition(".")[2])
    return f"{abs(value) * (100 if percent else 1):.{decimals}f}"


def test_quoted_numbers_are_those_of_the_summaries() -> None:
    assert len(quoted(PAGE)) > 20 and len(quoted(README)) == 8
    wrong = [
        (told, name, entry)
        for told, percent, name, entry in quoted(PAGE) + quoted(README)
        if told != as_told(summary_of(name)["headline"][entry], told, percent)
    ]
    assert wrong == []


def test_every_number_that_names_its_source_is_checked() -> None:
    for page in (PAGE, README):
        assert len(quoted(page)) == len(re.findall(r"`\w+/[\w.]+` \|", page.read_text()))


def test_shown_figures_are_there() -> None:
    shown = re.findall(r"!\[[^]]*\]\(([^)]+)\)", PAGE.read_text())
    assert [path for path in shown if not (PAGE.parent / path).resolve().is_file()] == []


def test_results_are_of_the_full_size_and_of_the_command_on_the_page() -> None:
    names = {name for *_, name, _ in quoted(PAGE)} - {*TASKS}
    summaries = {name: summary_of(name) for name in names}
    assert [name for name, summary in summaries.items() if summary["quick"] is not False] == []
    text = PAGE.read_text()
    assert [name for name, s in summaries.items() if f"    {s['command']}\n" not in text] == []
