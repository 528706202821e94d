"""Handwriting's results: each number is at its shape and robot."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import torch

from reproduction import handwriting
from reproduction.handwriting import (
    SEEDS,
    SHAPES,
    TRIALS,
    left_out_ratios,
    needed_runs,
    ratio,
    results,
)
from tests.helpers.summaries import leave_summary
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.tasks.handwriting import Writing

TASKS = [(robot, shape) for robot, shapes in SHAPES.items() for shape in shapes]
FACTORS = (1.1, 0.5, 7.0, 0.9, 0.6, 2.0, 0.7, 3.0, 0.8, 4.0)  # a seed's error over its median


def errors(error: float) -> dict[str, dict[str, float]]:
    """Of a run whose demonstrations spread by 0.01 m."""
    spread = {"x": 0.0, "y": 0.01}
    return {"rms_error": {"x": 0.6 * error, "y": 0.8 * error}, "demonstration_spread": spread}


def test_every_shape_and_robot_has_a_folder_for_every_seed(tmp_path: Path) -> None:
    runs = needed_runs(tmp_path, False)
    assert len({run.out for run in runs}) == len(runs) == len(TASKS) * len(SEEDS) == 60
    assert {run.learn.keywords["trials"] for run in runs} == {TRIALS} == {12}
    names = [f"handwriting_{shape}_double_pendulum" for shape in ("Angle", "Sshape")]
    assert [run.out for run in runs[:2]] == [tmp_path / name / "seed_0" for name in names]
    assert len(needed_runs(tmp_path, True)) == 1
    for run in runs[:: len(SEEDS) + 1]:  # they go to other processes
        sent = pickle.loads(pickle.dumps(run))
        start = run.learn.keywords["experiment"].initial.mean
        assert torch.equal(sent.learn.keywords["experiment"].initial.mean, start)


def test_every_median_is_at_its_shape_and_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ratio(errors(0.01)) == pytest.approx(1.0)  # in another direction than the spread
    point = torch.zeros(1, 2, 2, dtype=torch.float64)
    drawn = Writing(point, Gaussian(point[0, 1:], torch.eye(2, dtype=torch.float64)[None]), point)
    monkeypatch.setattr(handwriting, "writing", lambda folder, shape, robot: drawn)
    runs = needed_runs(tmp_path, False)
    for index, run in enumerate(runs):
        number, seed = index % len(TASKS), index // len(TASKS)
        error = 0.01 * (1 + number) * FACTORS[seed]
        leave_summary(run.out, seed=seed, experience_s=20.0 + seed, **errors(error))
    found = results([run.out for run in runs], quick=False)
    for number, (robot, shape) in enumerate(TASKS):
        assert found.headline[f"{robot}_{shape}_ratio"] == pytest.approx(1 + number)
        assert found.headline[f"{robot}_{shape}_experience_s"] == 24.5
    assert found.headline["worst_ratio"] == pytest.approx(7.0 * len(TASKS))
    assert found.headline["writers_own_success"] == pytest.approx(19 / 28)
    assert found.figures.keys() == SHAPES.keys()
    assert len(found.figures["double_pendulum"].axes) == 4
    measured = [(one["robot"], one["shape"]) for one in found.details["measured"]]
    assert measured == [task for task in TASKS for _ in SEEDS]


def test_writer_who_is_left_out_is_as_far_off_as_a_further_stroke_would_be() -> None:
    """N strokes of unit spread: the expected squared ratio is 1 + 1 / (N - 1) = 1.25 of five."""
    generator = torch.Generator().manual_seed(0)
    strokes = torch.randn(5, 20_001, 2, dtype=torch.float64, generator=generator)
    ratios = left_out_ratios(Demonstrations(strokes, 0.1, ("x", "y")))
    assert ratios == pytest.approx([1.25**0.5] * 5, rel=0.02)
