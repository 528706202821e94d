"""The numbers of the pages are filled in from the summaries of results, and from nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.extensions import extension
from tests.helpers.pages import PAGES

summaries = extension("summaries")

TEXTS = {page: page.read_text() for page in PAGES}
TABLE = re.compile(r"^```\{results\} (\S+)\n((?::.*\n)*)((?:[^`:].*\n)*)```$", re.MULTILINE)
NUMBER = re.compile(r"\{result\}`(\S+) ([^`]+)`")
TABLES = [(page, *found) for page, text in TEXTS.items() for found in TABLE.findall(text)]
NUMBERS = [(page, *found) for page, text in TEXTS.items() for found in NUMBER.findall(text)]
ALL = [
    path.parent.relative_to(summaries.RESULTS).as_posix()
    for path in summaries.RESULTS.rglob("summary.json")
]


def options(text: str) -> dict[str, str]:
    return dict(re.findall(r"^:(\w+): (.*)$", text, re.MULTILINE))


def used() -> Iterator[tuple[Path, str]]:
    """Each page with the name of a summary of which it has numbers."""
    yield from ((page, name) for page, name, _ in NUMBERS)
    for page, source, given, _ in TABLES:
        for key in options(given).get("columns", "").split(" | "):
            yield page, source.replace("<column>", key.partition(" = ")[0])


def command_on(page: Path, name: str) -> str:
    """What makes a summary, as the page that shows its numbers says it."""
    if name.startswith("tasks/"):
        return "make results"
    if name.startswith("paper/") and page.stem == "results":
        return "python scripts/reproduce.py NAME"
    return summaries.summary_of(name)["command"]


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A summary ``paper/example``."""
    runs = [{"seed": seed, "rate": rate} for seed, rate in enumerate((1.0, 0.9, 0.95))]
    summary = {"headline": {"rate_1.5s": 0.876, "never_s": None, "lost": -2}, "runs": runs}
    (tmp_path / "paper" / "example").mkdir(parents=True)
    (tmp_path / "paper" / "example" / "summary.json").write_text(json.dumps(summary))
    monkeypatch.setattr(summaries, "RESULTS", tmp_path)


@pytest.mark.usefixtures("example")
@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{rate_1.5s:.0%} of {rate_1.5s:.2f}", "88 % of 0.88"),
        ("{lost} or {never_s:.1f}", "−2 or never"),
        ("{runs/rate:.0%}", "90 to 100 %"),
        ("{runs/seed=1/rate}, {runs/2/rate:.0%}", "0.9, 95 %"),
        ("{lost..rate_1.5s:.1f}", "−2.0 to 0.9"),
    ],
)
def test_fields_are_filled_with_entries(template: str, text: str) -> None:
    assert summaries.fill("paper/example", template) == text


@pytest.mark.usefixtures("example")
def test_rows_and_columns_are_keys_or_lines() -> None:
    table = summaries.table
    rate, seeds = "rate: {runs/<row>/rate:.1f}", "0 = first | 2"
    assert table("paper/example", [rate], rows=seeds) == [
        ["", "rate"],
        ["first", "1.0"],
        ["2", "0.9"],
    ]
    turned = table("paper/example", [rate.replace("row", "column")], columns=seeds)
    assert turned == [["", "first", "2"], ["rate", "1.0", "0.9"]]
    both = table("paper/example", ["{runs/<row>/<column>}"], rows="0", columns="seed | rate")
    assert both == [["", "seed", "rate"], ["0", "0", "1.0"]]
    texts = table("paper/example", ["lost: none | {lost}"], columns="paper | here")
    assert texts == [["", "paper", "here"], ["lost", "none", "−2"]]


@pytest.mark.usefixtures("example")
@pytest.mark.parametrize("line", ["no such number: {rat}", "one row of two: {runs/<row>/rate}"])
def test_row_or_column_without_numbers_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match="has no entries for"):
        summaries.table("paper/example", [line], rows="0 | seven")


def test_every_table_and_every_number_of_the_pages_is_filled() -> None:
    assert len(TABLES) == sum(text.count("```{results}") for text in TEXTS.values()) > 30
    assert len(NUMBERS) == sum(text.count("{result}`") for text in TEXTS.values()) > 10
    for _, source, given, lines in TABLES:
        cells = str(summaries.table(source, lines.splitlines(), **options(given)))
        assert not re.search("[{}<>]", cells), cells
    assert all(summaries.fill(name, template) for _, name, template in NUMBERS)


def test_a_page_says_which_file_a_table_is_of() -> None:
    """For those who read it where no table is filled."""
    files = [(page, f"`results/{source.partition('<')[0]}") for page, source, *_ in TABLES]
    assert [(page.name, file) for page, file in files if file not in TEXTS[page]] == []


def test_summaries_are_of_full_size_and_made_by_a_command_on_the_page() -> None:
    names = set(used())
    assert [name for _, name in names if summaries.summary_of(name).get("quick")] == []
    absent = [
        (page.name, name)
        for page, name in names
        if command_on(page, name) not in re.sub(r"\s+", " ", TEXTS[page])
    ]
    assert absent == []


def test_marked_are_the_results_whose_runs_ended_by_the_former_rule() -> None:
    assert len(ALL) > 40
    for name in ALL:
        text = summaries.path_of(name).read_text()
        if re.search(r'"stop_reason": "the own', text):
            former = re.search(r'in a row succeeded"', text) is not None
            assert former == ("present rule" in summaries.provenance(name)), name


def test_a_table_is_followed_by_its_file_its_version_and_its_commit() -> None:
    assert summaries.provenance("paper/ur5e") == (
        "`results/paper/ur5e/summary.json`: 18 runs, 2026-11-23, torch_pmil 0.2.0, commit aba7a2e."
    )
