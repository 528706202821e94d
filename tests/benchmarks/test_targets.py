"""The time of several targets beside that of one, from a few evaluations."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import torch

from benchmarks import targets


def test_every_size_and_number_of_threads_has_its_times(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "new" / "summary.json"
    monkeypatch.setattr(
        sys,
        "argv",
        [
            "targets.py",
            "--sizes",
            "30",
            "40",
            "--threads",
            "1",
            "--repeats",
            "1",
            "--json",
            str(file),
        ],
    )
    targets.main()
    report = json.loads(file.read_text())
    assert report["command"].startswith("python -m benchmarks.targets --sizes 30 40")
    assert [(row["n"], row["threads"]) for row in report["rows"]] == [(30, 1), (40, 1)]
    for row in report["rows"]:
        assert len(row["wall_s"]) == len(row["cpu_s"]) == len(row["targets"])
        assert all(seconds > 0 for seconds in (*row["wall_s"], row["formulas_cpu_s"]))
    assert report["headline"]["three_over_one_40_threads_1"] == report["rows"][1]["ratio"]
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert torch.get_num_threads() == 1


def test_no_repeats_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["targets.py", "--repeats", "0"])
    with pytest.raises(SystemExit):
        targets.main()
    assert "must be at least 1" in capsys.readouterr().err
