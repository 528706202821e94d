"""The frame of the reproduction: what is run and not run again, what is written and said."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import joblib
import pytest

from reproduction import reproduction
from reproduction.reproduction import (
    PaperExperiment,
    Results,
    Run,
    finish,
    learning_run,
    reproduce,
    root_of_runs,
)
from tests.helpers.summaries import leave_summary
from torch_pmil.plotting import Figure
from torch_pmil.runs.sources import hash_of_sources
from torch_pmil.runs.summaries import RunError
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.trainer.ending import LIMIT

COMMAND = "python scripts/reproduce.py toy"


def learn_quickly(out: Path, command: str, seed: int) -> None:
    """Leaves what a run leaves, and the process that it was in."""
    leave_summary(out, experiment="toy", seed=seed, command=command, process=os.getpid())


def fail(out: Path, command: str) -> None:
    raise ValueError("no good")


def toy_runs(root: Path, quick: bool) -> list[Run]:
    seeds = range(1 if quick else 2)
    return [Run(root / f"seed_{seed}", partial(learn_quickly, seed=seed)) for seed in seeds]


def toy_results(folders: Sequence[Path], quick: bool) -> Results:
    seeds = [json.loads((folder / "summary.json").read_text())["seed"] for folder in folders]
    return Results({"runs": len(folders)}, {"empty": Figure()}, {"seeds": seeds})


TOY = PaperExperiment("toy", "nothing", toy_runs, toy_results)


@pytest.fixture(autouse=True)
def one_process_in_an_empty_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(joblib, "cpu_count", lambda: 1)


def test_results_hold_headline_details_figures_and_where_all_comes_from() -> None:
    out, results = reproduce(TOY, False, COMMAND)
    assert (out, results.headline) == (Path("results/paper/toy"), {"runs": 2})
    summary = json.loads(Path("results/paper/toy/summary.json").read_text())
    assert {"date", "commit", "versions"} <= summary.keys()
    assert (summary["experiment"], summary["command"], summary["quick"]) == ("toy", COMMAND, False)
    assert (summary["headline"], summary["seeds"]) == ({"runs": 2}, [0, 1])
    runs = [(run["folder"], run["seed"], run["command"]) for run in summary["runs"]]
    assert runs == [(f"{root_of_runs()}/seed_{seed}", seed, COMMAND) for seed in (0, 1)]
    assert Path("results/paper/toy/empty.png").read_bytes().startswith(b"\x89PNG")


def test_a_quick_reproduction_touches_no_full_run_and_no_full_result() -> None:
    out, _ = reproduce(TOY, True, COMMAND)
    assert out == Path("results/quick/toy")
    left = sorted(str(path.parent) for path in Path().rglob("summary.json"))
    assert left == ["results/quick/toy", f"{root_of_runs()}/quick/seed_0"]
    assert json.loads((out / "summary.json").read_text())["quick"] is True


def test_finished_runs_are_not_run_again() -> None:
    reproduce(TOY, False, COMMAND)
    first, second = (root_of_runs() / f"seed_{seed}/summary.json" for seed in (0, 1))
    before = first.stat().st_mtime_ns
    second.unlink()
    second.parent.rmdir()
    reproduce(TOY, False, "another")
    assert first.stat().st_mtime_ns == before
    assert json.loads(second.read_text())["command"] == "another"


def test_replay_that_ended_at_a_limit_of_trials_is_finished(tmp_path: Path) -> None:
    """Its summary says so of the run that was replayed, and has no trials of its own."""
    (tmp_path / "summary.json").write_text(json.dumps({"stop_reason": LIMIT}))
    assert Run(tmp_path, print).finished


def test_runs_of_other_sources_are_left_alone_and_do_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reproduce(TOY, False, COMMAND)
    monkeypatch.setattr(reproduction, "hash_of_sources", lambda: "other")
    reproduce(TOY, False, "another")
    left = {
        str(path.parent): json.loads(path.read_text())["command"]
        for path in Path("runs").rglob("summary.json")
    }
    assert left == {
        f"{root_of_runs().parent / sources}/seed_{seed}": command
        for sources, command in ((hash_of_sources(), COMMAND), ("other", "another"))
        for seed in (0, 1)
    }


def test_failed_runs_are_named_after_the_others_were_run() -> None:
    bad, worse = Run(Path("runs/bad"), fail), Run(Path("runs/worse"), fail)
    runs = [bad, *toy_runs(Path("runs"), False), worse]
    with pytest.raises(RunError) as error:
        finish(runs, COMMAND)
    assert str(error.value) == "runs/bad: no good; runs/worse: no good"
    assert all((run.out / "summary.json").exists() for run in runs[1:3])


@pytest.mark.slow
def test_runs_that_are_missing_are_learned_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joblib, "cpu_count", lambda: 2)
    runs = toy_runs(Path("runs").absolute(), False)
    finish(runs, COMMAND)
    processes = {json.loads((run.out / "summary.json").read_text())["process"] for run in runs}
    assert os.getpid() not in processes


def test_our_own_runs_go_on_from_where_they_were_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple] = []

    def train(
        experiment: object, *settings: object, progress_bar: bool, on_trial: Callable, resume: bool
    ) -> None:
        asked.append((experiment.name, *settings, resume))

    monkeypatch.setattr(reproduction, "train", train)
    task = load_experiment("double_pendulum")
    finish([learning_run(Path("runs"), task, seed=3, trials=4)], COMMAND)
    assert asked == [("double_pendulum", 3, 4, Path("runs/double_pendulum/seed_3"), COMMAND, True)]
