"""The tracker on our model: its actions are those of a plan on the model that it has fitted."""

from __future__ import annotations

import pytest
import torch

from reproduction.baselines.gp_tracker import GPTracker
from reproduction.baselines.peer_run import Practice
from tests.helpers.short_run import quick_fits
from torch_pmil.tasks.registry import load_experiment


@pytest.mark.parametrize("name", ["double_pendulum", "double_pendulum_servo"])
def test_tracker_follows_a_plan_on_its_own_model(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_fits(monkeypatch)
    experiment = load_experiment(name)
    tracker = GPTracker(experiment, seed=100)
    Practice(experiment, tracker, seed=100, factor=1)
    tracker.fit()
    plan, actions = tracker.tracked.plan, experiment.actions
    x, u = torch.from_numpy(plan.states), actions.middle + torch.from_numpy(plan.actions)
    inputs = torch.cat([experiment.space.features(x[:-1]), u], -1)
    with torch.no_grad():
        outputs = tracker.dynamics.expansion.mean(inputs)
    following = tracker.dynamics.known_part(experiment.space).successors(x[:-1], u, outputs)
    torch.testing.assert_close(x[1:], following, rtol=0, atol=1e-9)
    for step in (0, experiment.horizon - 1):
        torch.testing.assert_close(tracker.act(step, x[step][None])[0], u[step])
