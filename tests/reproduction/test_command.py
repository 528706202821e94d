"""The reproducing script: what it says, and that it fails in one line."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest

from reproduction import PAPER
from reproduction.reproduction import PaperExperiment, Results, Run
from tests.helpers.run_script import run_script
from torch_pmil.plotting import Figure

SCRIPT = "scripts/reproduce.py"
Script = Callable[..., None]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The script, run in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return partial(run_script, monkeypatch, SCRIPT)


def toy(
    learn: Callable[[Path, str], object] | None = None, **headline: float | None
) -> PaperExperiment:
    def runs(root: Path, quick: bool) -> list[Run]:
        return [] if learn is None else [Run(root / "seed_0", learn)]

    def results(folders: Sequence[Path], quick: bool) -> Results:
        return Results({"pi": 3.14159265, "quick": quick, **headline}, {"empty": Figure()})

    return PaperExperiment("figure6", "nothing", runs, results)


def test_headline_and_files_are_told(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(PAPER, "figure6", toy())
    script("figure6")
    assert (
        capsys.readouterr().out == "pi: 3.142\nquick: 0\nsee results/paper/figure6/summary.json, "
        "results/paper/figure6/empty.png\n"
    )
    script("figure6", "--quick")
    assert "quick: 1\nsee results/quick/figure6/summary.json" in capsys.readouterr().out


def test_what_never_came_about_is_told_and_written_as_such(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(PAPER, "figure6", toy(experience_to_95=None))
    script("figure6")
    assert "experience_to_95: never\n" in capsys.readouterr().out
    assert (
        json.loads(Path("results/paper/figure6/summary.json").read_text())["headline"][
            "experience_to_95"
        ]
        is None
    )


def test_unknown_name_is_refused_with_those_there_are(
    script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        script("figure99")
    assert stop.value.code == 2
    assert all(name in capsys.readouterr().err for name in ("figure99",))


def test_help_says_what_each_experiment_shows(
    script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        script("--help")
    told = capsys.readouterr().out
    assert all(
        f"{name} " in told and experiment.shows in told for name, experiment in PAPER.items()
    )


def test_failed_run_is_one_line(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(out: Path, command: str) -> None:
        raise OSError("disk full")

    monkeypatch.setitem(PAPER, "figure6", toy(fail))
    with pytest.raises(SystemExit) as stop:
        script("figure6")
    assert stop.value.code == "error: runs/seed_0: disk full"


def test_interrupted_reproduction_says_how_to_go_on(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(out: Path, command: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setitem(PAPER, "figure6", toy(interrupted))
    with pytest.raises(SystemExit) as stop:
        script("figure6", "--quick")
    assert stop.value.code == 130
    assert capsys.readouterr().err.endswith(
        "stopped; go on with: python scripts/reproduce.py figure6 --quick\n"
    )
