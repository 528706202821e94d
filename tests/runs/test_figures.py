"""The figures of a run: every experiment has those that say something of it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from matplotlib.figure import Figure

from tests.helpers.short_run import quick_fits, shortened
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.plotting import save_figure
from torch_pmil.runs import figures
from torch_pmil.runs.figures import figures_of, planes_of, sliced
from torch_pmil.runs.training import RunResult, train
from torch_pmil.tasks.method import RandomMotion
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.tasks.strokes import lasa_strokes
from torch_pmil.tasks.task import Task

STEPS = 6
OF_ALL = {"learning_curve", "calibration", "model"}
OF_A_TASK = {"trajectories", "kl_per_step", "policy"}
OWN = {f"double_pendulum{kind}": {"poses"} for kind in ("", "_pilco", "_servo", "_targets")}
OWN |= {f"handwriting{robot}": {"writing"} for robot in ("", "_biorob")}
WHOLE = {"handwriting", "handwriting_biorob", "inverted_pendulum"}  # whose error is of all steps


def short(name: str) -> Task:
    """The first steps of a task, and searches of a few evaluations."""
    task = load_experiment(name, lasa_strokes("Angle") if name in WHOLE & OWN.keys() else None)
    steps = task.horizon if name in WHOLE else STEPS
    return shortened(task, steps, exploration=RandomMotion())


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_its_figures(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    task = short(name)
    result = train(task, 0, 1, tmp_path / "run", "", progress_bar=False)
    figures = dict(figures_of(task, result))
    of_a_task = OF_A_TASK - ({"kl_per_step"} if name == "double_pendulum_pilco" else set())
    count = len(result.outcomes)
    targets = [f"_target_{number}" for number in range(count)] if count > 1 else [""]
    assert figures.keys() == OF_ALL | {
        kind + target for kind in of_a_task for target in targets
    } | OWN.get(name, set())
    for kind, figure in figures.items():
        save_figure(figure, tmp_path / f"{kind}.png")


def test_planes_of_a_cart_have_its_one_motor() -> None:
    space = load_experiment("inverted_pendulum").space
    way = torch.tensor([[[0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0, 4.0]]]).double()
    planes = planes_of(space, 1, way)
    assert [(plane.x, plane.y, plane.action) for plane in planes] == [(0, 2, 0), (1, 3, 0)]
    assert planes[0].span == (pytest.approx((-0.3, 1.3)), pytest.approx((-0.9, 3.9)))


def test_slices_go_over_torques_and_over_one_feature_at_least() -> None:
    relevance = torch.tensor([1.0, 3.0, 2.0, 0.1, 0.4, 0.3, 0.2])
    expected = {1: [0, 1, 2, 6], 3: [1, 4, 5, 6], 5: [1, 2, 4, 5]}
    assert {torques: sliced(relevance, torques) for torques in expected} == expected


def test_what_shows_a_prediction_is_left_out_where_there_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("_learning_curve", "_calibration", "_model"):
        monkeypatch.setattr(figures, name, lambda task, result: Figure())
    task = load_experiment("double_pendulum")
    shape = task.demonstrated.mean.shape
    nothing = Gaussian(torch.full(shape, torch.nan), torch.full((*shape, 4), torch.nan))
    rollouts = task.robots(2, seed=100).rollout(task.horizon)
    outcomes = task.outcomes(nothing, rollouts, task.error(rollouts))
    result = RunResult({}, [], outcomes, policy=None, dynamics=None, task=None)
    assert {"kl_per_step", "policy"}.isdisjoint(dict(figures_of(task, result)))
