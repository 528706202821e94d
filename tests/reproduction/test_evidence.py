"""Evidence: which results are old, what makes them, and what is said of failures."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

from reproduction import evidence
from torch_pmil.runs.sources import hash_of_sources

ROOT = Path(__file__).parents[2]
COMMANDS = {
    "one": "python -c \"print('one')\"",
    "two": "python -c 'raise SystemExit(1)'",
    "three": "python -c 'raise SystemExit(1)'",
}


def leave(name: str, sources: str | None) -> None:
    """A result of these sources."""
    folder = Path("results", name)
    folder.mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps({"sources": sources} if sources else {}))


@pytest.fixture
def three_results(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(evidence, "COMMANDS", COMMANDS)
    monkeypatch.setattr(sys, "argv", ["evidence"])


def test_every_result_of_the_repository_has_a_command() -> None:
    results = ROOT / "results"
    folders = [path.parent.relative_to(results) for path in results.rglob("summary.json")]
    names = {folder.as_posix() for folder in folders if folder.parts[0] != "quick"}
    assert names == evidence.COMMANDS.keys()


@pytest.mark.usefixtures("three_results")
def test_old_are_results_of_other_sources_without_sources_and_missing() -> None:
    leave("one", hash_of_sources())
    leave("two", None)
    assert evidence.old_results(Path("results")) == {"two": "unknown", "three": "missing"}
    leave("three", "0123456789ab")
    assert evidence.old_results(Path("results")) == {"two": "unknown", "three": "0123456789ab"}


@pytest.mark.usefixtures("three_results")
def test_each_command_is_run_once_and_a_failure_stops_no_other(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit, match=re.escape(f"error: 1 commands failed: {COMMANDS['two']}")):
        evidence.main()
    said = capfd.readouterr().out
    assert "3 of 3 results" in said and said.count("ended after") == said.count("\none\nended") == 1
    assert said.count("failed after 0 min: ") == 1


@pytest.mark.usefixtures("three_results")
def test_nothing_runs_where_all_is_of_the_present_sources(
    capfd: pytest.CaptureFixture[str],
) -> None:
    for name in COMMANDS:
        leave(name, hash_of_sources())
    evidence.main()
    assert capfd.readouterr().out == f"0 of 3 results are not of the sources {hash_of_sources()}\n"
