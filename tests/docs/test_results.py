"""The pages of results and the README quote what the reproduction wrote, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
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
    (path,) = (ROOT / "results").glob(f"**/{name}/summary.json")
    return json.loads(path.read_text())


def as_told(value: float, told: str, percent: str) -> str:
    """A value with as many decimals as the page gives it."""
    decimals = len(told.partition(".")[2])
    return f"{abs(value) * (100 if percent else 1):.{decimals}f}"


def test_quoted_numbers_are_those_of_the_summaries() -> None:
    assert len(quoted(PAGE)) > 20 and len(quoted(README)) == 15
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
    assert [name for name, summary in summaries.items() if summary.get("quick")] == []
    text = PAGE.read_text() + EVERY_SEED.read_text()
    assert [name for name, s in summaries.items() if f"    {s['command']}\n" not in text] == []


def test_tables_of_every_seed_are_those_of_the_summaries() -> None:
    rows = [*causes_and_ends(summary_of("where_runs_fail")), *causes(summary_of("soak"))]
    rows += [*coverage(summary_of("where_runs_fail")), *coverage(summary_of("soak"))]
    rows += tasks(summary_of("soak")["tasks"])
    lines = [" | ".join(["", *row, ""]).strip() for row in rows]
    text = EVERY_SEED.read_text().splitlines()
    assert [line for line in lines if line not in text] == []
    ends = [" | ".join(["", *row, ""]).rstrip() for row in costs(summary_of("quiet")["compared"])]
    assert [end for end in ends if not any(line.endswith(end) for line in text)] == []


def causes(summary: dict) -> Iterator[list[str]]:
    counted = summary["counts"].values()
    for cause in summary["counts"]["all"]["causes"]:
        yield [cause, *(str(found["causes"][cause]) for found in counted)]
    for told, entry in (("trials", "trials"), ("not needed", "trials_not_needed")):
        yield [told, *(str(found["totals"][entry]) for found in counted)]


def causes_and_ends(summary: dict) -> Iterator[list[str]]:
    yield from causes(summary)
    for end in summary["counts"]["all"]["ends"]:
        yield [end, *(str(found["ends"][end]) for found in summary["counts"].values())]


def coverage(summary: dict) -> Iterator[list[str]]:
    for task, found in summary["coverage_ahead"].items():
        shares = [found[when].get(steps) for when in found for steps in ("1", "5", "10", "25")]
        yield [task, *("" if share is None else f"{100 * share:.0f}" for share in shares)]


def costs(compared: dict[str, dict]) -> list[list[str]]:
    """Medians before and now of each task, without the name of the task."""
    forms = ("experience_s", "{:.1f} s"), ("wall_seconds", "{:.0f} s")
    return [
        [form.format(found[entry][side]) for entry, form in forms for side in ("theirs", "ours")]
        for task, found in compared.items()
        if task != "all"
    ]


def tasks(numbers: dict[str, dict]) -> Iterator[list[str]]:
    """Rows of the table with a column for each task."""
    for told, entry, form in (
        ("runs of 30 at 95 % or more", "at_95", "{:d}"),
        ("experience, median", "median_experience_s", "{:.1f} s"),
        ("the longest", "longest_experience_s", "{:.1f} s"),
        ("computing of a core, median", "median_cpu_seconds", "{:.0f} s"),
        ("error over the writers' spread, median", "median_ratio", "{:.2f}"),
        ("the largest", "worst_ratio", "{:.2f}"),
    ):
        cells = [form.format(of[entry]) if entry in of else "" for of in numbers.values()]
        yield [told, *cells]
