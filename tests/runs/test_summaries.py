"""Several runs together: their folders, their damage and their mean success rate."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from torch_pmil.runs.summaries import (
    RunError,
    SuccessCurve,
    count_trials,
    find_runs,
    is_finished,
    read_summary,
    success_over_experience,
    wilson_interval,
)


def make_run(experience_s: object, *rates: float, saved: object = 1.0) -> dict:
    """A summary with a trial each 2.5 s."""
    trials = [{"experience_s": 2.5 * k, "success_rate": rate} for k, rate in enumerate(rates, 1)]
    numbers = {"seed": 0, "wall_seconds": 10.0, "two_sigma_coverage": 0.9, "saved_trial": 1}
    texts = {"experiment": "e", "stop_reason": "limit"}
    measured = {"experience_s": experience_s, "saved_success_rate": saved, "trials": trials}
    return {**texts, **measured, **numbers}


def without(entry: str) -> dict:
    summary = make_run(5.0, 0.5)
    del summary[entry]
    return summary


def write_run(folder: Path, summary: object | None) -> Path:
    folder.mkdir(parents=True)
    (folder / "metrics.csv").write_text("trial,kl\n1,3.0\n2,2.0\n")
    if summary is not None:
        text = summary if isinstance(summary, str) else json.dumps(summary)
        (folder / "summary.json").write_text(text)
    return folder


def test_own_rollouts_count_where_there_were_no_fresh_starts(tmp_path: Path) -> None:
    ends = [{"success_rate": None, "own_success": success} for success in (False, True)]
    trials = [{"experience_s": 2.5 * number, **end} for number, end in enumerate(ends, start=1)]
    alone = make_run(7.5) | {"trials": trials}
    write_run(tmp_path / "seed_0", alone)
    curve = success_over_experience([read_summary(tmp_path / "seed_0"), make_run(5.0, 0.5, 0.5)])
    assert curve.rates[0].tolist() == [0, 1, 1]


def test_runs_are_found_in_a_folder_of_runs_or_by_themselves_and_once(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / "runs" / f"seed_{seed}", make_run(5.0, 1.0)) for seed in (0, 1)]
    (tmp_path / "runs" / "slurm").mkdir()
    (tmp_path / "runs" / "multirun.yaml").touch()
    assert find_runs([tmp_path / "runs"]) == runs
    assert find_runs([runs[1], tmp_path / "runs"]) == [runs[1], runs[0]]
    (tmp_path / "runs" / "latest").symlink_to(runs[0], target_is_directory=True)
    assert len(find_runs([tmp_path / "runs", tmp_path / "runs" / ".." / "runs"])) == len(runs)


def test_trials_of_a_run_without_summary_count_unless_they_are_damaged(tmp_path: Path) -> None:
    run = write_run(tmp_path / "seed_0", None)
    assert not is_finished(run)
    assert count_trials(run) == 2
    (run / "metrics.csv").write_bytes(b"trial,kl\n\xff\xfe\n")
    with pytest.raises(RunError, match=f"{run}: metrics.csv is damaged"):
        count_trials(run)


RATE = "success_rate must be a number from 0 to 1, got "
DAMAGED = [
    ("{", "is damaged: must be JSON, got Expecting"),
    ("[1]", "is damaged"),
    ({"seed": 0}, "has no 'trials'"),
    (make_run(5.0), "is damaged: it has no trial"),
    (make_run(5.0, 0.5, saved=None), f"is damaged: {RATE}None"),
    (make_run(5.0, 1.5), f"is damaged: {RATE}1.5"),
    (make_run("5", 0.5), "is damaged: experience_s must be a number from 0 to 1e+09, got '5'"),
    (make_run(float("nan"), 0.5), "is damaged: must be JSON, got NaN, which is not finite"),
    (make_run(5.0, 0.5) | {"experiment": None}, "is damaged: experiment must be text, got None"),
    (make_run(5.0, 0.5) | {"trials": [{"experience_s": 2.5}]}, "has no 'success_rate'"),
    *((without(entry), f"has no '{entry}'") for entry in ("seed", "stop_reason")),
]


@pytest.mark.parametrize(("summary", "complaint"), DAMAGED)
def test_damaged_summary_is_named_with_its_folder_in_one_line(
    tmp_path: Path, summary: object, complaint: str
) -> None:
    run = write_run(tmp_path / "seed_0", summary)
    with pytest.raises(RunError) as error:
        read_summary(run)
    assert str(error.value).startswith(f"{run}: summary.json {complaint}")
    assert "\n" not in str(error.value)


def test_summary_comes_back_whole_and_one_that_is_a_folder_is_named(tmp_path: Path) -> None:
    assert read_summary(write_run(tmp_path / "seed_0", make_run(5.0, 0.5))) == make_run(5.0, 0.5)
    run = write_run(tmp_path / "seed_1", None)
    (run / "summary.json").mkdir()
    with pytest.raises(RunError, match=r"is damaged: must be a regular file .* a folder"):
        read_summary(run)


def test_a_run_that_ended_early_is_carried_forward_with_its_saved_policy() -> None:
    curve = success_over_experience(
        [make_run(7.5, 0.0, 1.0, saved=0.9), make_run(12.5, 0.0, 0.0, 0.2, 0.4, saved=0.8)]
    )
    np.testing.assert_array_equal(curve.experience_s, [2.5, 5.0, 7.5, 10.0, 12.5])
    np.testing.assert_array_equal(curve.rates, [[0, 1, 0.9, 0.9, 0.9], [0, 0, 0.2, 0.4, 0.8]])
    np.testing.assert_allclose(curve.mean, [0, 0.5, 0.55, 0.65, 0.85])
    interval = wilson_interval(np.array(0.85), 2)
    np.testing.assert_allclose((curve.lower[-1], curve.upper[-1]), interval)


def test_between_two_measurements_a_run_counts_with_its_last_one() -> None:
    slow = make_run(10.0, 0.0, saved=1.0)
    curve = success_over_experience([slow, make_run(10.0, 0.0, 0.25, 0.5, saved=1.0)])
    np.testing.assert_array_equal(curve.rates[0], [0, 0, 0, 1])


def test_curve_begins_where_every_run_was_measured_once_and_rounding_splits_nothing() -> None:
    late, rounded = make_run(10.0, 0.5, 1.0), make_run(10.0, 0.0, 0.5)
    late["trials"] = late["trials"][1:]
    rounded["trials"][1]["experience_s"] = 0.1 * 50 + 1e-12
    for other, measured in ((late, [5.0, 10.0]), (rounded, [2.5, 5.0, 10.0])):
        curve = success_over_experience([make_run(10.0, 0.0, 0.5), other])
        assert curve.experience_s.tolist() == measured


@pytest.mark.parametrize("count", [1, 2, 4, 10, 50, 1000])
def test_interval_of_whole_successes_is_scipys_and_any_lies_between_0_and_1_around_the_mean(
    count: int,
) -> None:
    rates = np.arange(count + 1)
    exact = [binomtest(int(k), count).proportion_ci(0.95, method="wilson") for k in rates]
    found = wilson_interval(rates / count, count)
    np.testing.assert_allclose(found, np.transpose(exact), atol=1e-12)
    mean = np.linspace(0, 1, 101)
    lower, upper = wilson_interval(mean, count)
    assert ((lower >= 0) & (lower <= mean) & (mean <= upper) & (upper <= 1)).all()


@pytest.mark.parametrize(("a", "b"), [(0.05, 0.05), (0.3, 0.1), (2.0, 2.0), (8.0, 1.0)])
def test_interval_of_ten_draws_between_0_and_1_covers_their_mean_at_least_as_often_as_it_says(
    a: float, b: float
) -> None:
    draws = np.random.default_rng(0).beta(a, b, size=(20_000, 10))
    lower, upper = wilson_interval(draws.mean(1), 10)
    coverage = ((lower <= a / (a + b)) & (a / (a + b) <= upper)).mean()
    assert coverage > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 20_000)


def curve_of(*mean: float) -> SuccessCurve:
    """Measured at 2.5 s, 5 s, ..."""
    rates = np.array(mean)
    return SuccessCurve(2.5 * np.arange(1, len(mean) + 1), rates[None], rates, rates, rates)


def test_curve_holds_its_last_measurement() -> None:
    seconds = (2.4, 2.5, 4.9, 5.0, 33.0, float("inf"))
    rates = [curve_of(0.1, 0.2, 0.3).at(experience_s) for experience_s in seconds]
    assert rates == [0.1, 0.1, 0.1, 0.2, 0.3, 0.3]


def test_rate_is_reached_the_first_time_or_never() -> None:
    means = ((0.0, 0.96, 0.5, 1.0), (0.0, 0.95 - 1e-15), (0.0, 0.94))
    assert [curve_of(*mean).experience_to(0.95) for mean in means] == [5.0, 5.0, None]
