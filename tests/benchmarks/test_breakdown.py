"""The breakdown of an evaluation's time, at sizes that say nothing of speed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import breakdown
from torch_pmil.model.compiled import objective


def test_every_part_has_its_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file, kernel = tmp_path / "new" / "breakdown.json", objective.predict
    monkeypatch.setattr(
        sys, "argv", ["breakdown", "--sizes", "10", "60", "--seconds", "0.3", "--json", str(file)]
    )
    breakdown.main()
    assert objective.predict is kernel
    report = json.loads(file.read_text())
    assert [row["n"] for row in report["rows"]] == [10, 60]
    for row in report["rows"]:
        times = row["cpu_ms"]
        assert set(times) == set(report["parts"]) == set(breakdown.PARTS)
        assert 0 < times["pairs of data"] < times["model"] < times["whole"]
        parts = (times[part] for part in ("prediction", "adjoint", "costs", "Python"))
        assert sum(parts) == pytest.approx(times["whole"], abs=0.003)  # each is rounded
    assert report["command"].startswith("python -m benchmarks.breakdown --sizes 10 60")


def test_parts_are_computed_at_the_beliefs_of_the_prediction() -> None:
    """Moments once more leave what the prediction left."""
    calls = breakdown.Calls()
    with calls.watched():
        breakdown.evaluation(20)()
    robot, tape, work = calls.arguments["prediction"]
    records = tape.of_model, tape.of_network
    before = [[values.copy() for values in (record.q, record.slope)] for record in records]
    functions = breakdown.within(robot, tape, work)
    for record in records:
        record.q[:], record.slope[:] = 0.0, 0.0
    for function in functions.values():
        assert function()
    for record, (q, slope) in zip(records, before, strict=True):
        np.testing.assert_array_equal(record.q, q)
        np.testing.assert_array_equal(record.slope, slope)
