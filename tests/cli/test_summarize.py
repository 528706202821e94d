"""``pmil summarize``: its table, its two files, and one line for what is wrong."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.run_script import run_command
from torch_pmil.runs.summaries import wilson_interval

Script = Callable[..., None]


def write_run(
    folder: Path, seed: int, experience_s: float, rate: float, experiment: str = "double_pendulum"
) -> Path:
    """A finished run with one trial, which failed."""
    run = write_unfinished_run(folder, seed)
    summary = {"experiment": experiment, "seed": seed, "experience_s": experience_s}
    summary |= {"saved_success_rate": rate, "saved_trial": 1, "two_sigma_coverage": 0.9}
    summary |= {"wall_seconds": 100.0 + seed, "stop_reason": "limit of trials"}
    trials = [{"experience_s": 2.5, "success_rate": 0.0}]
    (run / "summary.json").write_text(json.dumps({**summary, "trials": trials}))
    return run


def write_unfinished_run(folder: Path, seed: int) -> Path:
    run = folder / f"seed_{seed}"
    run.mkdir(parents=True)
    (run / "metrics.csv").write_text("trial,kl\n1,3.0\n2,2.0\n")
    return run


def summary_in(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


@pytest.fixture
def summarize(monkeypatch: pytest.MonkeyPatch) -> Script:
    return partial(run_command, monkeypatch, "summarize")


def error_of(summarize: Script, *arguments: Path | str) -> str:
    with pytest.raises(SystemExit) as stop:
        summarize(*arguments)
    message = stop.value.code
    assert isinstance(message, str) and message.startswith("error: ") and "\n" not in message
    return message.removeprefix("error: ")


def test_headline_counts_runs_that_learned_within_the_papers_experience(
    summarize: Script, tmp_path: Path
) -> None:
    for run in ((2, 20.0, 0.9), (0, 25.0, 0.95), (1, 35.0, 1.0)):
        write_run(tmp_path / "runs", *run)
    summarize(tmp_path / "runs", "--out", tmp_path / "results")
    merged = summary_in(tmp_path / "results")
    assert [run["seed"] for run in merged["runs"]] == [0, 1, 2]
    headline = merged["headline"]
    assert (headline["seeds"], headline["learned_within_33s"]) == (3, 1)
    assert (headline["median_experience_s"], headline["max_wall_seconds"]) == (25.0, 102.0)
    assert headline["two_sigma_coverage"] == pytest.approx(0.9)


def test_results_say_where_they_come_from_and_hold_the_curve_with_its_interval(
    summarize: Script, tmp_path: Path
) -> None:
    runs = [write_run(tmp_path / "runs", seed, 5.0, rate) for seed, rate in enumerate((1.0, 0.5))]
    summarize(*runs, "--out", tmp_path / "results")
    merged = summary_in(tmp_path / "results")
    assert merged["command"] == f"pmil summarize {runs[0]} {runs[1]} --out {tmp_path / 'results'}"
    assert {"experiment", "date", "commit", "versions"} <= merged.keys()
    curve = merged["success_over_experience"]
    assert (curve["experience_s"], curve["mean"]) == ([2.5, 5.0], [0.0, 0.75])
    interval = wilson_interval(np.array([0.0, 0.75]), 2)
    np.testing.assert_allclose([curve["lower"], curve["upper"]], interval)
    picture = tmp_path / "results" / "success_over_experience.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert sorted(os.listdir(tmp_path / "results")) == [picture.name, "summary.json"]


def test_results_lie_beside_the_runs_if_not_said_otherwise_and_can_be_made_again(
    summarize: Script, tmp_path: Path
) -> None:
    run = write_run(tmp_path / "runs", 0, 5.0, 1.0)
    for folder in (tmp_path / "runs", run):
        summarize(folder)
        assert summary_in(tmp_path / "runs")["headline"]["seeds"] == 1


@pytest.mark.parametrize("name", ["summary.json", "success_over_experience.png"])
def test_results_do_not_replace_a_file_of_another(
    name: str, summarize: Script, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write_run(tmp_path / "runs", 0, 5.0, 1.0)
    (tmp_path / "runs" / name).write_text("mine")
    with pytest.raises(SystemExit, match=f"{name} was not written by pmil summarize: move"):
        summarize(run)
    assert (tmp_path / "runs" / name).read_text() == "mine"
    assert {*os.listdir(tmp_path / "runs")} == {run.name, name}


def test_table_has_a_line_for_each_run_and_leaves_out_those_that_have_not_ended(
    summarize: Script, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in (10, 9):
        write_run(tmp_path / "runs", seed, 27.5, 0.95)
    write_unfinished_run(tmp_path / "runs", 3)
    summarize(tmp_path / "runs")
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [Path(row[0]).name for row in rows[1:4]] == ["seed_9", "seed_10", "seed_3"]
    assert rows[1][1:] == ["27.5", "1", "1", "95%", "109", "limit", "of", "trials"]
    assert rows[3][1:] == ["2", "not", "ended:", "left", "out"]
    assert summary_in(tmp_path / "runs")["headline"]["seeds"] == 2


def test_runs_of_two_experiments_are_refused(summarize: Script, tmp_path: Path) -> None:
    write_run(tmp_path / "a", 0, 20.0, 1.0)
    write_run(tmp_path / "b", 1, 20.0, 1.0, experiment="biorob")
    complaint = error_of(summarize, tmp_path / "a", tmp_path / "b", "--out", tmp_path / "results")
    assert complaint == "runs must be of one experiment, got biorob, double_pendulum"
    assert not (tmp_path / "results").exists()


def test_a_damaged_run_is_named_and_nothing_is_written(summarize: Script, tmp_path: Path) -> None:
    write_run(tmp_path / "runs", 0, 20.0, 1.0)
    damaged = write_run(tmp_path / "runs", 1, 20.0, 1.0)
    (damaged / "summary.json").write_text('{"experiment": "double_pen')
    message = f"{damaged}: summary.json is damaged: "
    assert error_of(summarize, tmp_path / "runs").startswith(message)
    assert sorted(os.listdir(tmp_path / "runs")) == ["seed_0", "seed_1"]


def test_runs_that_have_not_ended_are_refused_and_the_summary_of_one_is_not_replaced(
    summarize: Script, tmp_path: Path
) -> None:
    run = write_unfinished_run(tmp_path / "begun", 0)
    assert error_of(summarize, tmp_path / "begun") == f"none of the runs has ended: {run}"
    run = write_run(tmp_path / "runs", 0, 5.0, 1.0)
    before = (run / "summary.json").read_text()
    message = f"{run} is a run: the results would replace its summary.json"
    assert error_of(summarize, run, "--out", run) == message
    assert (run / "summary.json").read_text() == before
