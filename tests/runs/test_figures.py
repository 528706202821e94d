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
OWN = {
    "double_pendulum": {"poses"},
    "double_pendulum_pilco": {"poses"},
    "double_pendulum_servo": {"poses"},
    "double_pendulum_targets": {"poses"},
    "handwriting": {"writing"},
    "handwriting_biorob": {"writing"},
}
WHOLE = {"handwriting", "handwriting_biorob", "inverted_pendulum"}  # whose error is of all steps


def short(name: str) -> Task:
    """The first steps of an experiment, and searches of a few evaluations."""
    if name.startswith("handwriting"):
        task = load_experiment(name, lasa_strokes("Angle"))
    else:
        task = load_experiment(name)
    steps = task.horizon if name in WHOLE else STEPS
    return shortened(task, steps, exploration=RandomMotion())


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_its_figures(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    experiment = short(name)
    result = train(
        experiment, seed=0, trials=1, out=tmp_path / "run", command="", progress_bar=False
    )
    figures = dict(figures_of(experiment, result))
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
    planes = planes_of(
        space, 1, torch.tensor([[[0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0, 4.0]]]).double()
    )
    assert [(plane.x, plane.y, plane.action) for plane in planes] == [(0, 2, 0), (1, 3, 0)]
    assert planes[0].span == (pytest.approx((-0.3, 1.3)), pytest.approx((-0.9, 3.9)))


def test_slices_go_over_torques_and_over_one_feature_at_least() -> None:
    relevance = torch.tensor([1.0, 3.0, 2.0, 0.1, 0.4, 0.3, 0.2])
    assert [sliced(relevance, torques) for torques in (1, 3, 5)] == [
        [0, 1, 2, 6],
        [1, 4, 5, 6],
        [1, 2, 4, 5],
    ]


def test_what_shows_a_prediction_is_left_out_where_there_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("_learning_curve", "_calibration", "_model"):
        monkeypatch.setattr(figures, name, lambda experiment, result: Figure())
    experiment = load_experiment("double_pendulum")
    shape = experiment.demonstrated.mean.shape
    nothing = Gaussian(torch.full(shape, torch.nan), torch.full((*shape, 4), torch.nan))
    rollouts = experiment.robots(2, seed=100).rollout(experiment.horizon)
    outcomes = experiment.outcomes(nothing, rollouts, experiment.error(rollouts))
    result = RunResult({}, [], outcomes, policy=None, dynamics=None)
    assert {"kl_per_step", "policy"}.isdisjoint(dict(figures_of(experiment, result)))
