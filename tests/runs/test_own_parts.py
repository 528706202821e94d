"""Runs with a policy, a model or a cost of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.testing import assert_close

from torch_pmil import GPDynamics, SaturatingCost, load_experiment, load_policy, own_cost
from torch_pmil.runs.figures import figures_of
from torch_pmil.runs.training import RunResult, train
from torch_pmil.tasks.own_parts import with_own
from torch_pmil.tasks.task import Task

STATE = ("x", "q", "dx", "dq")
UPRIGHT = SaturatingCost(target={"q": 0.0}, width=0.1)


def two_layers(inputs: int, outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, 8), nn.Tanh(), nn.Linear(8, outputs))


class Rest:
    """A linear model of the changes by least squares, with a GP on what it leaves."""

    def fit(self, inputs: Tensor, targets: Tensor) -> None:
        normal = inputs.mT @ inputs + 1e-6 * torch.eye(inputs.shape[1]).double()
        self.slopes = torch.linalg.solve(normal, inputs.mT @ targets)
        self.gp = GPDynamics(inputs.shape[1], targets.shape[1])
        self.gp.fit(inputs, targets - inputs @ self.slopes)
        self.noise = self.gp.noise

    def moments(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        mean, variance = self.gp.predict(inputs)
        return mean + inputs @ self.slopes, variance


def effort(states: Tensor, actions: Tensor) -> Tensor:
    return (states[..., 1] / 0.1).square() + 0.01 * actions.square().sum(-1)


def upright(states: Tensor) -> Tensor:
    return states[:, :, 1].abs().amax(-1) < 0.2


def task(cost: Any = UPRIGHT, **settings: Any) -> Task:
    pytest.importorskip("gymnasium")
    given = {"state": STATE, "search.sample_steps": 5, "num_centres": 5} | settings
    return own_cost("InvertedPendulum-v5", cost, 12, 0.04, **given)


def learned(task: Task, out: Path, trials: int = 1, resume: bool = False) -> RunResult:
    return train(task, 1, trials, out, "", progress_bar=False, resume=resume)


OWN = {
    "policy": {"policy": two_layers},
    "model": {"model": Rest()},
    "cost": {"cost": effort, "success": upright},
}


@pytest.mark.parametrize("part", OWN)
def test_stopped_run_goes_on_to_the_same_policy(part: str, tmp_path: Path) -> None:
    whole = learned(task(**OWN[part]), tmp_path / "whole", 2)
    learned(task(**OWN[part]), tmp_path / "stopped", 1)
    resumed = learned(task(**OWN[part]), tmp_path / "stopped", 2, resume=True)
    for name, tensor in whole.policy.policy.state_dict().items():
        assert torch.equal(tensor, resumed.policy.policy.state_dict()[name]), name


@pytest.mark.parametrize("part", OWN)
def test_run_draws_its_figures_and_saves_its_policy(part: str, tmp_path: Path) -> None:
    result = learned(task(**OWN[part]), tmp_path / "run")
    names = {name for name, _ in figures_of(result.task, result)}
    assert {"learning_curve", "trajectories", "calibration", "model", "policy"} <= names
    make = two_layers if part == "policy" else None
    states = torch.zeros(3, 4, dtype=torch.float64)
    saved = load_policy(tmp_path / "run" / "policy.pt", make)
    assert_close(saved(states), result.policy(states).detach())


def test_run_with_another_policy_or_model_is_another_run(tmp_path: Path) -> None:
    learned(task(**OWN["policy"]), tmp_path / "policy")
    with pytest.raises(ValueError, match=r"has policy = Sequential.*cannot go on so"):
        learned(task(policy=nn.Linear), tmp_path / "policy", 2, resume=True)
    learned(task(**OWN["model"]), tmp_path / "model")
    with pytest.raises(ValueError, match="has model = Rest"):
        learned(task(model=type("Other", (Rest,), {})()), tmp_path / "model", 2, resume=True)


def test_module_holds_a_robot_whose_actions_are_targets() -> None:
    """As the first RBF network does: from there the search has a slope to follow."""
    servo = load_experiment("double_pendulum_servo")
    own = with_own(servo, None, two_layers, None)
    policy = own.make_policy(torch.Generator().manual_seed(0))
    assert servo.holding_actions is not None
    starts = servo.initial.sample(100, torch.Generator().manual_seed(1))
    apart = policy(servo.space.features(starts)) - servo.holding_actions(starts)
    assert (apart.square().mean(0).sqrt() < 0.05 * servo.actions.half_range).all()


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"policy": nn.Linear(4, 1)}, TypeError, "policy must make a torch.nn.Module from the"),
        (
            {"policy": lambda features: nn.Linear(features, 1)},
            TypeError,
            r"features and actions, as .*Linear does, got a function of \(features\): too many",
        ),
        (
            {"policy": lambda i, o: nn.Linear(i, 3)},
            ValueError,
            r"to \(2, 1\), got \(2, 3\)",
        ),
        ({"model": nn.Linear(4, 1)}, TypeError, "model must have the methods fit"),
        ({"cost": effort}, TypeError, "success must say which motions are successes"),
        ({"cost": 3}, TypeError, "cost must be a SaturatingCost, a QuadraticCost or a function"),
    ],
)
def test_part_of_another_kind_is_refused(
    wrong: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        made = task(**wrong).scaled_by(torch.rand(13, 4).double())
        made.make_policy(torch.Generator().manual_seed(0))
