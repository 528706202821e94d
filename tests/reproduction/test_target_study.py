"""Studies of targets: what a run writes, and what the results make of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from reproduction import figure11, reaching as reaching_study
from reproduction.figure11 import BALLS
from reproduction.reaching import PLACES
from reproduction.target_study import METHODS, TargetStudy, inside_triangle, read_measurement
from reproduction.teachers import reaching
from tests.helpers.short_run import quick_fits, short_experiment
from tests.helpers.summaries import leave_summary
from torch_pmil.envs import hitting_plane
from torch_pmil.runs.summaries import RunError
from torch_pmil.search.policy_search import SearchSettings

STEPS = 4
G = 35


def write(folder: Path, training: list[float], joint: list[float], **changes: object) -> Path:
    """The measurement of a run; the other methods reach nothing."""
    grid = {
        name: {"success": joint if name == "joint" else [0.0] * G, "value": [0.1] * G}
        for name in METHODS
    }
    run = {
        "experience_s": 20.0,
        "trials": [{"loss": 9.0}] * 4,
        "learning_seconds": 100.0,
        "training": {"success": training, "value": [0.1] * 3},
        "grid": grid,
    }
    return leave_summary(folder, **run | changes)


def test_grids_are_those_of_the_robots() -> None:
    torch.testing.assert_close(BALLS.grid, hitting_plane.GRID)
    torch.testing.assert_close(PLACES.grid, reaching.TEST_TARGETS)


def test_report_counts_grid_points_that_most_starts_reach(tmp_path: Path) -> None:
    inside = inside_triangle(BALLS.grid, hitting_plane.TRAINING_TARGETS)
    assert inside.sum() == 9
    joint = np.where(inside, 1.0, 0.0)
    joint[0], joint[1] = 0.6, 0.5  # of which the first counts
    folders = [
        write(tmp_path / "a", [1.0, 1.0, 0.9], joint.tolist()),
        write(tmp_path / "b", [1.0] * 3, [1.0] * G, experience_s=30.0),
    ]
    headline = BALLS.results(folders).headline
    expected = {
        "training_success_rate": 5.9 / 6,
        "worst_training_success_rate": 0.9,
        "grid_fraction": (10 + 35) / 70,
        "least_grid_fraction": 10 / 35,
        "triangle_fraction": 1.0,
        "grid_success_rate": (9 + 1.1 + 35) / 70,
        "blended_grid_fraction": 0.0,
        "nearest_triangle_fraction": 0.0,
        "max_trials": 4,
        "max_experience_s": 30.0,
    }
    assert {name: headline[name] for name in expected} == pytest.approx(expected)


def test_measurement_of_something_else_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="does not say what was reached"):
        read_measurement(tmp_path)
    with pytest.raises(RunError, match="does not say what was reached: 'blended'"):
        read_measurement(write(tmp_path / "run", [1.0] * 3, [1.0] * G, grid={"joint": {}}))


@pytest.mark.parametrize(
    ("study", "experiment"),
    [
        (PLACES, "double_pendulum_targets"),
        pytest.param(BALLS, "biorob_targets", marks=pytest.mark.slow),
    ],
)
def test_short_study_learns_measures_and_goes_on(
    study: TargetStudy, experiment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = short_experiment(STEPS, experiment, search=SearchSettings(0, 1, 1, first_horizon=1.0))
    quick_fits(monkeypatch)
    study = replace(study.quick, trials=1, experiment=lambda: short)
    (run,) = study.needed_runs(tmp_path)
    assert run.out == tmp_path / study.name / "seed_0"
    run.learn(run.out, "python scripts/reproduce.py")
    learned = tmp_path / experiment / "seed_0"
    assert (learned / "summary.json").exists()
    policy = (learned / "policy.pt").read_bytes()
    run.learn(run.out, "python scripts/reproduce.py")
    assert (learned / "policy.pt").read_bytes() == policy
    measured = read_measurement(run.out)
    assert len(measured["training"]["success"]) == 3
    assert len(measured["grid"]["blended"]["value"]) == G
    results = study.results([run.out], picture=np.zeros((60, 80, 3), dtype=np.uint8))
    assert list(results.figures) == [study.name]
    assert results.headline["training_success_rate"] == 0.0  # in 0.4 s nothing is reached


def test_narrow_functions_are_reported_beside_the_wide_ones(tmp_path: Path) -> None:
    runs = reaching_study.needed_runs(tmp_path, quick=True)
    assert [run.out.parent.name for run in runs] == ["reaching", "reaching_narrow"]
    narrow, wide = reaching_study.narrow(), reaching_study.double_pendulum_targets()
    assert narrow.target_scale < wide.target_scale
    reached = {"wide": [1.0] * G, "narrow": [0.0] * G}
    folders = [write(tmp_path / name, [1.0] * 3, grid) for name, grid in reached.items()]
    headline = reaching_study.results(folders, quick=True).headline
    assert (headline["grid_fraction"], headline["narrow_grid_fraction"]) == (1.0, 0.0)


def test_missing_opengl_leaves_the_picture_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise RuntimeError("no OpenGL")

    monkeypatch.setattr(figure11, "draw_targets", fail)
    with pytest.warns(RuntimeWarning, match="no picture of the set-up: no OpenGL"):
        assert figure11.set_up() is None
