"""The task of one's own robot with a cost beside its demonstrations."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from torch_pmil import PMIL, SaturatingCost, load_experiment, shipped_demonstrations
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.search.improving_loss import ImprovingKLLoss
from torch_pmil.search.target_costs import FunctionCost
from torch_pmil.tasks.improving_task import ImprovingTask, improving
from torch_pmil.tasks.task import Task

UP = SaturatingCost(target={"y2": 1.0}, width=0.5)


def task(**given: Any) -> Task:
    """The double pendulum as a robot of one's own."""
    shown = load_experiment("double_pendulum")
    learner = PMIL(
        DoublePendulumEnv(),
        shipped_demonstrations("double_pendulum"),
        0.1,
        state=shown.space.names,
        angles=("q1", "q2"),
        match=shown.space.match_space,
        initial=shown.initial,
        **given,
    )
    return learner.task


def effort(states: Tensor, actions: Tensor) -> Tensor:
    return actions.square().sum(-1)


def test_cost_makes_a_task_that_improves() -> None:
    made = task(cost=UP)
    assert isinstance(made, ImprovingTask)
    assert made.cost is UP and made.imitation_weight == 1.0
    loss = made.problem(0).loss
    assert isinstance(loss, ImprovingKLLoss) and not loss.improving
    assert loss.horizon == loss.cost.horizon == made.horizon
    assert (
        task(cost=UP, imitation_weight=0.2).with_settings(**{"cost.width": 0.1}).cost.width == 0.1
    )


def test_function_is_a_cost_too() -> None:
    made = task(cost=effort, imitation_weight=0.2)
    assert isinstance(made, ImprovingTask) and isinstance(made.cost, FunctionCost)
    assert made.settings["cost"] == {"cost": "effort"}
    assert made.settings["imitation_weight"] == 0.2


def test_task_without_a_cost_is_as_it_was() -> None:
    plain, ours = task(), task(cost=UP, imitation_weight=0.2)
    assert type(plain) is Task
    added = {"cost": UP.said, "imitation_weight": 0.2}
    assert ours.settings == plain.settings | added and not added.keys() & plain.settings.keys()
    keys = ours.problem(0).loss.state_dict().keys()
    assert keys == plain.problem(0).loss.state_dict().keys() | {"improving"}


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"imitation_weight": 0.1}, ValueError, "imitation_weight must come with a cost, got none"),
        (
            {"cost": UP, "imitation_weight": 0.0},
            ValueError,
            "imitation_weight must be a finite number, above 0, got 0.0",
        ),
        (
            {"cost": SaturatingCost(target={"z": 1.0}, width=0.5)},
            ValueError,
            "target must name entries of the match space x1, y1, x2, y2, got z",
        ),
        (
            {"cost": "up"},
            TypeError,
            "cost must be a SaturatingCost, a QuadraticCost or a function of states and actions, "
            "got 'up'",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(
    given: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as refused:
        task(**given)
    assert str(refused.value) == message


def test_cost_itself_is_asked_for() -> None:
    shown = load_experiment("double_pendulum")
    with pytest.raises(
        TypeError, match=r"^cost must be a SaturatingCost, .* FunctionCost, got int"
    ):
        ImprovingTask(**(vars(shown) | {"cost": 1}))
    assert torch.equal(improving(shown, UP).demonstrated.mean, shown.demonstrated.mean)
