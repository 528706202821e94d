"""Ours beside peers that were recorded: the same seeds, and the recorded numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from reproduction.recorded_peers import ANEW, RECORDED, needed_runs, results
from tests.helpers.summaries import leave_summary, trial
from torch_pmil.files import read_json

ROOT = Path(__file__).parents[2]


def test_ours_is_compared_with_the_recorded_runs_of_the_same_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ours succeeds from 20 s on; what it is ahead is then all that a peer lacks."""
    monkeypatch.chdir(ROOT)
    runs = needed_runs(tmp_path, quick=False)
    assert len({run.out for run in runs}) == len(runs) == 10 * len(ANEW)
    for run in runs:
        trials = [trial(time, float(time >= 20), own_success=False) for time in (10.0, 20.0)]
        numbers = {"experience_s": 20.0, "saved_success_rate": 1.0, "trials": trials}
        leave_summary(run.out, experiment="any", seed=int(run.out.name[5:]), **numbers)
    found, recorded = results([run.out for run in runs], quick=False), read_json(RECORDED)
    assert set(found.figures) == {"double_pendulum"}
    for task in ANEW:
        assert found.headline[f"experience_to_95_{task}_ours"] == 20.0
        assert found.headline[f"success_12.5s_{task}_ours"] == 0.0
        for label, ahead in found.details[task]["ahead"].items():
            curve = recorded[task]["curves"][label]
            column = sum(time <= 25.0 for time in curve["experience_s"]) - 1
            theirs = [rates[column] for rates in curve["rates"]]
            assert ahead["25s"]["pairs"] == 10
            assert ahead["25s"]["difference"] == pytest.approx(1 - sum(theirs) / 10)
    quickest = {task: found.headline[f"experience_to_95_{task}_quickest_peer"] for task in ANEW}
    assert quickest["double_pendulum"] == 12.5  # the search on particles
    assert quickest["Sshape"] == 9.0  # the tracker
