"""The breakdown of an evaluation's time, at sizes that say nothing of speed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from benchmarks import breakdown
from torch_pmil.gp import moment_derivatives
from torch_pmil.model import rollout

WATCHED = (
    (rollout, "unroll"),
    (moment_derivatives, "pairwise_kernel_sums"),
    (moment_derivatives.RecordedMoments, "_sum_up"),
    (rollout._MomentStep, "jacobian"),
    (rollout._MomentStep, "parameter_gradients"),
)


def test_every_part_has_its_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for owner, name in WATCHED:
        monkeypatch.setattr(
            owner, name, getattr(owner, name)
        )  # what the script puts in its place is taken back
    file = tmp_path / "new" / "breakdown.json"
    monkeypatch.setattr(
        sys, "argv", ["breakdown.py", "--sizes", "10", "12", "--repeats", "2", "--json", str(file)]
    )
    breakdown.main()
    report = json.loads(file.read_text())
    assert [row["n"] for row in report["rows"]] == [10, 12]
    for row in report["rows"]:
        times = row["cpu_ms"]
        assert set(times) == set(report["parts"]) == set(breakdown.PARTS)
        assert 0 < times["pairs of data"] < times["rollout"] < times["whole"]
    assert report["command"].startswith("python -m benchmarks.breakdown --sizes 10 12")
