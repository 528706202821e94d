"""The numbers of the pages are filled in from the summaries of results, and from nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from reproduction.evidence import COMMANDS
from tests.helpers.extensions import extension
from tests.helpers.pages import PAGES

summaries = extension("summaries")

TEXTS = {page: page.read_text() for page in PAGES}
TABLES = [(page, *found) for page, text in TEXTS.items() for found in summaries.TABLE.findall(text)]
NUMBERS = [
    (page, *found) for page, text in TEXTS.items() for found in summaries.NUMBER.findall(text)
]
FILES = [*summaries.RESULTS.rglob("summary.json")]


options = summaries.options


def command_on(page: Path, name: str) -> str:
    """What makes a summary, as the page that shows its numbers says it."""
    if name.startswith("paper/") and page.stem == "experiments":
        return "python scripts/reproduce.py NAME"
    return COMMANDS[name]


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
    turned = [["", "first", "2"], ["rate", "1.0", "0.9"]]
    assert table("paper/example", [rate], rows=seeds) == [*map(list, zip(*turned, strict=True))]
    assert table("paper/example", [rate.replace("row", "column")], columns=seeds) == turned
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
    for page, source, given, lines in TABLES:
        cells = str(summaries.table(source, lines.splitlines(), **options(given)))
        assert not re.search("[{}<>]", cells), cells
        file = f"`results/{source.partition('<')[0]}"  # for those who read where none is filled
        assert file in TEXTS[page], (page.name, source)
    assert all(summaries.fill(name, template) for _, name, template in NUMBERS)


def test_summaries_are_of_full_size_and_made_by_a_command_on_the_page() -> None:
    used = {(page, name) for page, name, _ in NUMBERS}
    for page, source, given, _ in TABLES:
        used |= {(page, name) for name in summaries.sources(source, **options(given))}
    for page, name in used:
        assert not summaries.summary_of(name).get("quick"), name
        assert command_on(page, name) in re.sub(r"\s+", " ", TEXTS[page]), (page.name, name)


def leave(folder: Path, sources: str | None, of_run: str | None) -> None:
    """A summary of one run, made by these sources."""
    stamp = {"date": "2026-11-23T05:49:00+00:00", "commit": "398dfdc"}
    run = stamp | ({"sources": of_run} if of_run else {})
    versions = {"versions": {"torch_pmil": "0.2.0"}}
    summary = stamp | versions | {"headline": {"rate": 1.0}, "runs": [run], "sources": sources}
    folder.mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps(summary))
    summaries.summary_of.cache_clear()


@pytest.mark.parametrize(
    ("sources", "of_run", "older"),
    [
        ("present", "present", False),
        ("present", None, False),
        ("present", "other", True),
        ("other", "other", True),
        (None, None, True),
    ],
)
def test_a_page_says_which_results_are_of_earlier_sources(
    sources: str | None,
    of_run: str | None,
    older: bool,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr(summaries, "RESULTS", tmp_path)
    monkeypatch.setattr(summaries, "hash_of_sources", lambda: "present")
    leave(tmp_path / "paper" / "another", sources, of_run)
    said = "`results/paper/another/summary.json`: 2026-11-23, torch_pmil 0.2.0, commit 398dfdc."
    assert summaries.provenance("paper/another") == said + " **Of earlier sources.**" * older
    for page in (
        "{result}`paper/another {rate:.0%}` of them",
        "```{results} paper/<column>\n:columns: another\nrate: {rate:.0%}\n```",
        "![a figure](../../results/paper/another/rates.png)",
    ):
        assert summaries.note_of_older(page) == (
            "Of earlier sources on this page (`make evidence`): `results/paper/another`." * older
        )


def test_times_of_a_policys_step_are_those_on_its_page_and_below_a_millisecond() -> None:
    ((source, given, lines),) = (rest for page, *rest in TABLES if page.name == "deploy.md")
    shown = summaries.table(source, lines.splitlines(), **options(given))
    for row in summaries.summary_of("benchmarks/policy_step")["rows"]:
        names = ("cpu_us_min", "cpu_us_median", "wall_us_median", "wall_us_99_percent")
        assert [row["form"], *(f"{row[name]:.0f}" for name in names)] in shown
        assert row["cpu_us_median"] < 1000 and row["wall_us_median"] < 1000
