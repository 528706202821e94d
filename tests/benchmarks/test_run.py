"""The CPU time of a whole run by part."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from benchmarks import run
from benchmarks.run import PARTS, Clock


def test_a_parts_time_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([2.0, 5.0, 6.0, 10.0, 11.0, 13.0])
    monkeypatch.setattr(run, "cpu_seconds", lambda: next(times))
    clock = Clock()  # at 2
    kernel = clock.timed("kernels", lambda value: value + 1)  # from 6 to 10
    with clock.inside("optimiser"):  # from 5 to 11
        assert kernel(1) == 2
    clock.enter("rest")
    assert dict(clock.seconds) == {"imports": 2, "rest": 5, "optimiser": 2, "kernels": 4}


@pytest.mark.slow
def test_parts_of_a_run_add_up() -> None:
    command = [sys.executable, "-m", "benchmarks.run", "--alone"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    parts = [found[f"cpu_seconds_{part}"] for part in PARTS]
    assert sum(parts) == pytest.approx(found["cpu_seconds_total"], abs=0.1)
    assert min(parts) > 0 and found["peak_mb"] > 300
