"""The reproducing script: what it says, and that it fails in one line."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest

from reproduction import PAPER
from reproduction.reproduction import PaperExperiment, Results, Run, root_of_runs
from tests.helpers.run_script import run_script
from torch_pmil.plotting import Figure

SCRIPT = "scripts/reproduce.py"
QUICKLY = f"python {SCRIPT} figure6 --quick"
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
    files = "results/paper/figure6/summary.json, results/paper/figure6/empty.png"
    assert capsys.readouterr().out == f"pi: 3.142\nquick: 0\nsee {files}\n"
    script("figure6", "--quick")
    assert "quick: 1\nsee results/quick/figure6/summary.json" in capsys.readouterr().out


def test_what_never_came_about_is_told_and_written_as_such(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(PAPER, "figure6", toy(experience_to_95=None))
    script("figure6")
    assert "experience_to_95: none\n" in capsys.readouterr().out
    written = json.loads(Path("results/paper/figure6/summary.json").read_text())
    assert written["headline"]["experience_to_95"] is None


def test_unknown_name_is_refused_and_help_says_what_each_experiment_shows(
    script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        script("figure99")
    assert stop.value.code == 2 and "figure99" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        script("--help")
    told = capsys.readouterr().out
    for name, experiment in PAPER.items():
        assert f"{name} " in told and experiment.shows in told


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (OSError("disk full"), f"error: {root_of_runs()}/quick/seed_0: disk full", ""),
        (
            KeyboardInterrupt(),
            130,
            f"stopped; go on with: {QUICKLY}\n",
        ),
    ],
)
def test_failed_run_is_one_line_and_an_interrupted_one_says_how_to_go_on(
    script: Script,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: str | int,
    told: str,
) -> None:
    def end(out: Path, command: str) -> None:
        raise error

    monkeypatch.setitem(PAPER, "figure6", toy(end))
    with pytest.raises(SystemExit) as stop:
        script("figure6", "--quick")
    assert stop.value.code == code
    assert capsys.readouterr().err.endswith(told)
