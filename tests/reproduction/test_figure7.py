"""Figures 7a and 7b: which runs they are of, and what is reported of their curves."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from reproduction import PAPER, figure7b
from reproduction.figure7 import success_curves
from reproduction.figure7a import needed_runs as runs_of_7a, results as results_7a
from reproduction.figure7b import needed_runs as runs_of_7b, results as results_7b
from reproduction.reproduction import Run
from tests.helpers.figures import legend_of
from tests.helpers.short_run import quick_fits, short_experiment
from tests.helpers.summaries import leave_summary, trial
from torch_pmil.runs.summaries import RunError, read_summary


def leave_runs(root: Path, curves: Mapping[str, Sequence[float]]) -> list[Path]:
    """Two runs of each method, a trial each 2.5 s; the last rate is that of the saved policy."""
    folders = []
    for method, rates in curves.items():
        for seed in range(2):
            folder = leave_summary(
                root / method / f"seed_{seed}",
                experiment=method,
                seed=seed,
                trials=[trial(2.5 * n, rate) for n, rate in enumerate(rates[:-1], start=1)],
                saved_success_rate=rates[-1],
                experience_s=2.5 * len(rates),
            )
            folders.append(folder)
    return folders


@pytest.mark.parametrize(
    ("needed", "names"),
    [(runs_of_7a, ("", "_pilco_trusting")), (runs_of_7b, ("", "_dmp", "_dmp_10hz"))],
)
def test_runs_are_our_ten_and_the_baselines_with_the_papers_seconds_of_experience(
    tmp_path: Path, needed: Callable[[Path, bool], list[Run]], names: tuple[str, ...]
) -> None:
    for quick, seeds, counts in ((False, 10, (13, 20)), (True, 2, (3, 3))):
        runs, methods = needed(tmp_path, quick), [f"double_pendulum{name}" for name in names]
        folders = [tmp_path / name / f"seed_{seed}" for name in methods for seed in range(seeds)]
        assert [run.out for run in runs] == folders
        trials = [run.learn.keywords["trials"] for run in runs]
        assert trials == [counts[0]] * seeds + [counts[1]] * seeds * (len(names) - 1)
    assert {"figure7a", "figure7b"} < PAPER.keys()


def test_report_of_7a_tells_when_each_is_at_95_percent_and_how_good_at_22_and_33_seconds(
    tmp_path: Path,
) -> None:
    ours = [0.0] * 7 + [0.5, 0.96, 1.0, 1.0]  # at 20, 22.5, 25 and 27.5 s
    pilco = [0.0] * 12 + [0.25] + [0.5] * 6 + [1.0, 0.9]  # at 32.5 s, from 35 s, at 50 and 52.5 s
    made = results_7a(leave_runs(tmp_path, {"ours": ours, "pilco": pilco}), quick=False)
    assert made.headline == {
        "ours_experience_to_95": 22.5,
        "ours_success_at_22.5s": 0.96,
        "ours_success_at_33s": 1.0,
        "pilco_experience_to_95": 50.0,
        "pilco_success_at_33s": 0.25,
        "pilco_final_success": 0.9,
    }
    assert list(made.figures) == ["figure7a"]
    assert made.details["curves"]["PILCO"]["mean"] == pilco
    json.dumps(made.details, allow_nan=False)


def test_report_of_7b_keeps_both_feedbacks_apart_and_says_never(tmp_path: Path) -> None:
    curves = {"ours": [0.0, 1.0], "dmp": [0.0, 0.9, 0.8], "dmp_10hz": [0.1, 0.2]}
    made = results_7b(leave_runs(tmp_path, curves), quick=False)
    expected = {}
    for name, rates in curves.items():
        expected[f"{name}_experience_to_95"] = 5.0 if name == "ours" else None
        expected[f"{name}_success_at_33s"] = expected[f"{name}_final_success"] = rates[-1]
    assert made.headline == expected
    assert legend_of(made.figures["figure7b"]) == list(made.details["curves"])


def test_damaged_run_is_named(tmp_path: Path) -> None:
    folders = leave_runs(tmp_path, {"ours": [0.0, 1.0], "other": [0.0, 1.0]})
    (folders[2] / "summary.json").write_text("{}")
    with pytest.raises(RunError, match=f"{folders[2]}: summary.json has no 'trials'"):
        success_curves(folders, ("ours", "other"))


def test_baseline_runs_with_the_feedback_that_its_folder_says_and_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    monkeypatch.setattr(figure7b, "load_experiment", lambda name: short_experiment(name=name))
    for name, period in (("double_pendulum_dmp", 0.01), ("double_pendulum_dmp_10hz", 0.1)):
        run = figure7b.dmp_run(tmp_path, name, seed=4, trials=1)
        for _ in range(2):
            run.learn(run.out, "command")
        summary = read_summary(tmp_path / name / "seed_4")
        assert (summary["seed"], summary["command"], len(summary["trials"])) == (4, "command", 1)
        assert summary["settings"]["feedback_period"] == period
