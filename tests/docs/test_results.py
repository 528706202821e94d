"""The pages of results and the README quote what the reproduction wrote, and nothing else."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
TASKS = {path.name for path in (ROOT / "results" / "tasks").iterdir()}  # by make results
PAGE = ROOT / "docs" / "results" / "results.md"
EVERY_SEED = PAGE.with_name("every_seed.md")
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
        for told, percent, name, entry in quoted(PAGE) + quoted(EVERY_SEED) + quoted(README)
        if told != as_told(summary_of(name)["headline"][entry], told, percent)
    ]
    assert wrong == []


def test_every_number_that_names_its_source_is_checked() -> None:
    for page in (PAGE, EVERY_SEED, README):
        assert len(quoted(page)) == len(re.findall(r"`\w+/[\w.]+` \|", page.read_text()))


def test_shown_figures_are_there() -> None:
    pages = PAGE.read_text() + EVERY_SEED.read_text()
    shown = re.findall(r"!\[[^]]*\]\(([^)]+)\)", pages)
    assert [path for path in shown if not (PAGE.parent / path).resolve().is_file()] == []


def test_results_are_of_the_full_size_and_of_the_command_on_the_page() -> None:
    names = {name for *_, name, _ in quoted(PAGE) + quoted(EVERY_SEED)} - {*TASKS}
    summaries = {name: summary_of(name) for name in names}
    assert [name for name, summary in summaries.items() if summary["quick"] is not False] == []
    text = PAGE.read_text() + EVERY_SEED.read_text()
    assert [name for name, s in summaries.items() if f"    {s['command']}\n" not in text] == []


def test_tables_of_every_seed_are_those_of_the_summary() -> None:
    summary, text = summary_of("where_runs_fail"), EVERY_SEED.read_text()
    counted = summary["counts"]
    rows = {
        name: [str(found[entry][name]) for found in counted.values()]
        for entry in ("causes", "ends")
        for name in counted["all"][entry]
    }
    rows |= {"trials": [str(found["totals"]["trials"]) for found in counted.values()]}
    rows |= {
        "not needed": [str(found["totals"]["trials_not_needed"]) for found in counted.values()]
    }
    for task, found in summary["coverage_ahead"].items():
        shares = [found[when].get(steps) for when in found for steps in ("1", "5", "10", "25")]
        rows[task] = ["" if share is None else f"{100 * share:.0f}" for share in shares]
    lines = [" | ".join(["", name, *cells, ""]).strip() for name, cells in rows.items()]
    assert [line for line in lines if line not in text.splitlines()] == []
