"""The sensitivity: each variant differs in one setting, and the numbers are those of the runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from reproduction.sensitivity import OURS, SEEDS, SETTINGS, needed_runs, results, variants
from tests.helpers.summaries import leave_summary


def test_each_variant_differs_in_one_setting_by_a_factor_of_two() -> None:
    tasks = variants()
    ours = tasks.pop(OURS).adjustable
    for label, task in tasks.items():
        name, word = label.split()
        values = task.adjustable
        assert [key for key in ours if values[key] != ours[key]] == [name]
        exact = ours[name] * {"halved": 0.5, "doubled": 2}[word]
        assert exact - 0.5 <= values[name] <= exact
    assert len(tasks) == 2 * len(SETTINGS)


def test_numbers_are_those_of_the_runs_seed_by_seed(tmp_path: Path) -> None:
    runs = needed_runs(tmp_path, quick=False)
    assert len({run.out for run in runs}) == len(runs) == len(SEEDS) * (2 * len(SETTINGS) + 1)
    for number, run in enumerate(runs):
        leave_summary(run.out, saved_success_rate=1.0 if number < len(SEEDS) else 0.75)
    found = results([run.out for run in runs], quick=False)
    assert found.headline["ours_success"] == 1.0
    assert found.headline["noise_std_halved_success"] == 0.75
    more = found.details["more_success"]["search.horizon_step_doubled"]
    assert more["difference"] == pytest.approx(-0.25) and more["pairs"] == len(SEEDS)
    assert set(found.figures) == {"sensitivity"}
