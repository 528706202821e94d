"""The script of the baseline with movement primitives: what it leaves, says and refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from tests.helpers.run_script import run_script
from tests.helpers.short_run import quick_fits, replace_task, short_experiment
from torch_pmil.runs.own_files import files_of

PERIOD = "feedback_period"
SCRIPT = "reproduction/baselines/train_dmp.py"
Script = Callable[..., None]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The script, in an empty folder, on the first steps of the double pendulum."""
    monkeypatch.chdir(tmp_path)
    replace_task(monkeypatch, short_experiment())
    quick_fits(monkeypatch)
    return partial(run_script, monkeypatch, SCRIPT)


def test_run_leaves_its_numbers_and_says_them(
    script: Script, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "seed=4", "trials=1", "feedback_period=0.1", "out=run"
    script(*words)
    out = tmp_path / "run"
    files = {str(path.relative_to(out)) for path in tmp_path.rglob("*") if path.is_file()}
    written = {"metrics.csv", "summary.json", "figures/learning_curve.png", "report.html"}
    assert files == written | {"run_files.json"} and files_of(out) == written
    summary = json.loads((out / "summary.json").read_text())
    assert summary["command"].split()[-5:] == ["reproduction.baselines.train_dmp", *words]
    assert summary["command"].startswith("python -m ")
    printed = capsys.readouterr().out
    assert "trial  1:   0.4 s of experience, own rollout" in printed
    assert "of 20 fresh starts after 0.8 s of experience" in printed
    assert "see run/report.html, run/summary.json" in printed


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("trials=0", "trials must be a whole number of at least 1, got 0"),
        (f"{PERIOD}=0.03", f"{PERIOD} must divide the control period of 0.1 s, got 0.03 s"),
        ("demonstrations=none.csv", "there is no file none.csv"),
    ],
)
def test_what_cannot_be_run_is_said_in_one_line(
    script: Script, override: str, message: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        script(override)
    assert stop.value.code == f"error: {message}"
