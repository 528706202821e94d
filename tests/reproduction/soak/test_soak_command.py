"""The command of the soak on runs that have ended: what it writes and says, and its errors."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest

from reproduction.reproduction import root_of_runs
from reproduction.soak import __main__ as command
from reproduction.soak.processes import Job
from reproduction.soak.results import MEASURED, REPLAYED
from tests.helpers.run_script import run_script
from tests.reproduction.soak.test_soak_results import REPLAY, promising, write_run

Script = Callable[..., None]
ROBOTS = ("double_pendulum", "gym_pendulum", "inverted_pendulum", "biorob")  # the first tasks


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The script, in an empty folder, where nothing is learned."""

    def nothing(jobs: Sequence[Job], *limits: object) -> None:
        assert [job.folder.name for job in jobs if (job.folder / "soak.json").exists()] == []

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "attempt_all", nothing)
    return partial(run_script, monkeypatch, "scripts/soak.py")


def leave_runs(root: Path, experience_s: float) -> None:
    for task in ROBOTS:
        folder = write_run(root, promising(task, 5, 1.0, 0.97, experience_s=experience_s))
        (folder / MEASURED).write_text('{"success_rate": 0.99, "starts": 100}')
        (folder / REPLAYED).write_text(json.dumps(REPLAY))


def test_results_of_runs_that_have_ended(
    script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    leave_runs(root_of_runs() / "soak", 10.0)
    leave_runs(Path("before"), 12.5)
    script("--runs", 4, "--first-seed", 5, "--against", "before")
    assert capsys.readouterr().out == (
        "runs: 4\nended: 4\nsaved_at_95: 4\nworst_claimed: 1\ndouble_pendulum_at_95: 1\n"
        "biorob_at_95: 1\nbiorob_joint_rms_deg: 3\npromise_kept: 1\n"
        "see results/soak/summary.json\n"
    )
    summary = json.loads(Path("results/soak/summary.json").read_text())
    assert summary["headline"]["promise_kept"] == 1.0
    assert summary["command"] == "python scripts/soak.py --runs 4 --first-seed 5 --against before"
    assert summary["compared"]["all"]["experience_s"]["difference"] == -2.5
    assert summary["compared"]["biorob"]["cpu_seconds"]["ours"] == 3.0
    left = sorted(path.name for path in Path("results/soak").iterdir())
    assert left == ["experience.png", "promises.png", "summary.json"]


def test_runs_that_did_not_end_are_an_error_that_names_them(script: Script) -> None:
    leave_runs(root_of_runs() / "soak", 10.0)
    with pytest.raises(SystemExit) as stop:
        script("--runs", 5, "--first-seed", 5)
    folder = f"{root_of_runs()}/soak/handwriting_Angle_double_pendulum/seed_5"
    assert stop.value.code == f"error: 1 of 5 runs did not end: {folder}"
    failed = json.loads(Path("results/soak/summary.json").read_text())["failed"][-1]
    assert (failed["folder"], failed["said"]) == (folder, "not begun")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--against", "nowhere"], "error: nowhere must hold runs as TASK/seed_N/summary.json"),
        (["--runs", 0], "2"),
    ],
)
def test_bad_arguments_are_one_line(script: Script, arguments: list, line: str) -> None:
    with pytest.raises(SystemExit) as stop:
        script(*arguments)
    assert str(stop.value.code).startswith(line)


def test_interrupted_soak_says_how_to_go_on(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "attempt_all", interrupted)
    with pytest.raises(SystemExit) as stop:
        script("--runs", 1)
    assert stop.value.code == 130
    assert capsys.readouterr().err.endswith(
        "stopped; go on with: python scripts/soak.py --runs 1\n"
    )
