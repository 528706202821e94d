"""The script that puts the summaries of several runs into one."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "summarise.py"


def write_run(folder: Path, seed: int, experience_s: float, rate: float, experiment: str = "double_pendulum") -> Path:
    path = folder / f"{experiment}_{seed}.json"
    run = {"experiment": experiment, "seed": seed, "experience_s": experience_s, "saved_success_rate": rate}
    path.write_text(json.dumps({**run, "wall_seconds": 100.0 + seed, "two_sigma_coverage": 0.9}))
    return path


def summarise(monkeypatch: pytest.MonkeyPatch, *arguments: Path) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, arguments)])
    runpy.run_path(str(SCRIPT), run_name="__main__")


def test_headline_counts_runs_that_learned_within_the_papers_experience(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Seed 1 took too long, seed 2 does not succeed often enough."""
    runs = [write_run(tmp_path, 2, 20.0, 0.9), write_run(tmp_path, 0, 25.0, 0.95), write_run(tmp_path, 1, 35.0, 1.0)]
    summarise(monkeypatch, tmp_path / "results" / "summary.json", *runs)
    merged = json.loads((tmp_path / "results" / "summary.json").read_text())
    assert [run["seed"] for run in merged["runs"]] == [0, 1, 2]
    headline = merged["headline"]
    assert (headline["seeds"], headline["learned_within_33s"], headline["median_experience_s"]) == (3, 1, 25.0)
    assert headline["max_wall_seconds"] == 102.0 and headline["two_sigma_coverage"] == pytest.approx(0.9)


def test_runs_of_two_experiments_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    runs = [write_run(tmp_path, 0, 20.0, 1.0), write_run(tmp_path, 1, 20.0, 1.0, experiment="biorob")]
    with pytest.raises(SystemExit) as stop:
        summarise(monkeypatch, tmp_path / "summary.json", *runs)
    assert stop.value.code == "error: runs must be of one experiment, got biorob, double_pendulum"
    assert not (tmp_path / "summary.json").exists()
