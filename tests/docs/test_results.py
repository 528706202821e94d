"""The page of results and the README quote what the reproduction wrote, and nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "results.md").read_text()
README = (ROOT / "README.md").read_text()
VALUE_AND_ENTRY = re.compile(
    r"\| ([\d.]+)( %)?[^|`\n]*\| `(\w+)/([\w.]+)` (?=\|)"
)  # | value unit | `NAME/entry` |
QUOTED = VALUE_AND_ENTRY.findall(PAGE)


def test_there_are_quoted_numbers() -> None:
    assert len(QUOTED) > 20
    assert len(VALUE_AND_ENTRY.findall(README)) > 10


@pytest.mark.parametrize(
    ("told", "percent", "name", "entry"), QUOTED + VALUE_AND_ENTRY.findall(README)
)
def test_quoted_number_is_that_of_the_summary(
    told: str, percent: str, name: str, entry: str
) -> None:
    value = json.loads((ROOT / "results" / name / "summary.json").read_text())["headline"][entry]
    decimals = len(told.partition(".")[2])
    assert told == f"{abs(value) * (100 if percent else 1):.{decimals}f}"


@pytest.mark.parametrize("page", [PAGE, README], ids=["results.md", "README.md"])
def test_every_number_that_names_its_source_is_checked(page: str) -> None:
    assert len(VALUE_AND_ENTRY.findall(page)) == len(re.findall(r"`\w+/[\w.]+` \|", page))


@pytest.mark.parametrize("path", re.findall(r"!\[[^]]*\]\(([^)]+)\)", PAGE))
def test_shown_figure_is_there(path: str) -> None:
    assert (ROOT / "docs" / path).resolve().is_file()


@pytest.mark.parametrize("name", sorted({name for *_, name, _ in QUOTED}))
def test_results_are_of_the_full_size_and_of_the_command_on_the_page(name: str) -> None:
    summary = json.loads((ROOT / "results" / name / "summary.json").read_text())
    assert summary["quick"] is False
    assert f"    {summary['command']}\n" in PAGE
