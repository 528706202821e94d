"""The tracker on our model: its plan is one of the model, and its actions are within the limits."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from reproduction.baselines.gp_tracker import GPTracker
from reproduction.baselines.peer_run import Practice
from tests.helpers.short_run import quick_fits
from torch_pmil.experiments import load_experiment


@pytest.mark.parametrize("name", ["double_pendulum", "double_pendulum_servo"])
def test_plan_is_the_mean_of_the_model_and_is_followed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    experiment = load_experiment(name)
    tracker = GPTracker(experiment, seed=100)
    Practice(experiment, tracker, seed=100, factor=1)
    tracker.fit()
    plan, actions = tracker._plan, experiment.actions
    assert plan.actions.shape == (experiment.horizon, 2)
    following = tracker._next(plan.states[:-1], plan.actions)
    np.testing.assert_allclose(plan.states[1:], following, rtol=0, atol=1e-9)
    np.testing.assert_allclose(plan.states[0], experiment.initial.mean)
    planned = torch.from_numpy(plan.states)
    for step in (0, experiment.horizon - 1):
        wanted = actions.middle + torch.from_numpy(plan.actions[step])
        torch.testing.assert_close(tracker.act(step, planned[step][None])[0], wanted)
        far = tracker.act(step, planned[step] + 1e6 * torch.eye(4).double())
        assert (far <= actions.high + 1e-12).all() and (far >= actions.low - 1e-12).all()


def test_costly_actions_are_those_that_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick_fits(monkeypatch)
    experiment, efforts = load_experiment("double_pendulum"), []
    for weight in (0.1, 1e10):
        tracker = GPTracker(experiment, 100, weight)
        Practice(experiment, tracker, seed=100, factor=1)
        tracker.fit()
        efforts.append(np.abs(tracker._plan.actions - tracker._cost.hold_action).max())
    assert efforts[1] < 0.01 < efforts[0]


@pytest.mark.parametrize("name", ["double_pendulum", "pendubot"])
def test_whole_turns_of_a_joint_change_neither_target_nor_feedback(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    experiment = load_experiment(name)
    tracker = GPTracker(experiment, seed=100)
    start, angles = experiment.initial.mean, list(experiment.space.angles)
    away = torch.from_numpy(tracker._cost.target)[0, angles] - start[angles]
    assert (away.abs() < 5 * experiment.initial.std[angles]).all()
    Practice(experiment, tracker, seed=100, factor=1)
    tracker.fit()
    state = torch.from_numpy(tracker._plan.states[3]) + 0.01
    turned = state.clone()
    turned[angles] += 2 * torch.pi * torch.tensor([1.0, -1.0]).double()
    torch.testing.assert_close(tracker.act(3, turned[None]), tracker.act(3, state[None]))
