"""Tasks whose state holds the past are the same tasks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.short_run import short_experiment
from torch_pmil.envs.rollouts import states_of
from torch_pmil.runs.training import train
from torch_pmil.search.target_costs import FunctionCost
from torch_pmil.tasks.improving_task import improving
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task
from torch_pmil.tasks.with_history import with_history

KINDS = {
    "delay": {"past_actions": 1},
    "positions": {"positions_only": True, "past_actions": 1},
    "much": {"past_entries": 1, "past_actions": 2},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["double_pendulum", "biorob", "double_pendulum_servo"])
def test_task_is_the_same(name: str, kind: str, generator: torch.Generator) -> None:
    """Match space, starts, errors and motions of the robot do not know of the past."""
    plain = load_experiment(name)
    task, dim = with_history(plain, **KINDS[kind]), plain.space.dim
    states = torch.cat([task.demonstrated_states, task.initial.mean[None]])
    expected = plain.space.observe(states[:, :dim])
    torch.testing.assert_close(task.space.observe(states), expected, rtol=0, atol=1e-12)
    hidden = kind == "positions"
    kept = [i for i, name in enumerate(plain.space.names) if not (hidden and name[:1] == "d")]
    shown, of_plain = task.demonstrated_states[:, kept], plain.demonstrated_states[:, kept]
    torch.testing.assert_close(shown, of_plain)
    assert torch.equal(task.initial.std[kept], plain.initial.std[kept])
    rollout = task.robot(seed=1).rollout(5)
    assert rollout["observation"].shape == (5, task.space.dim)
    assert task.make_policy(generator).centres.shape[-1] == len(task.space.feature_names)
    assert task.make_dynamics().num_outputs == len(kept)
    motion = task.exploration.motion(generator)
    assert motion(states_of(rollout)[0]).shape == (len(task.actions.names),)


def test_errors_are_those_of_the_states_shown_and_no_transition_is_left_out() -> None:
    plain = load_experiment("double_pendulum")
    task = with_history(plain, past_actions=1)
    rollouts = task.robots(4, seed=1).rollout(25)
    own = rollouts.copy()
    for key in ("observation", ("next", "observation")):
        own[key] = rollouts[key][..., :4]
    assert torch.equal(task.error(rollouts), plain.error(own))
    assert task.promised is not None


def test_past_angles_are_plain_numbers() -> None:
    task = with_history(load_experiment("double_pendulum"), past_entries=1)
    assert task.space.names[4:] == ("q1@1", "dq1@1", "q2@1", "dq2@1")
    assert task.space.angles == (0, 2)
    assert task.settings["least_widths"] == [1.5, 1.5, 0.35, 1.5, 0.35, 1.5, *[0.35] * 4]


def test_positions_need_velocities_to_tell() -> None:
    plain = load_experiment("double_pendulum").with_settings(velocities_alone=False)
    space = replace(plain.space, names=("a", "b", "c", "d"))
    with pytest.raises(ValueError, match=r"positions_only needs .* got a, b, c, d"):
        with_history(replace(plain, space=space), positions_only=True)


def test_second_history_is_refused() -> None:
    task = with_history(load_experiment("double_pendulum"), past_actions=1)
    with pytest.raises(ValueError, match="double_pendulum has a history already"):
        with_history(task, past_actions=1)


def test_past_needs_demonstrations() -> None:
    with pytest.raises(ValueError, match="double_pendulum_pilco must have demonstrations to rem"):
        with_history(load_experiment("double_pendulum_pilco"), past_actions=1)


def test_cost_function_sees_the_states_that_are_shown(draws: Draws) -> None:
    def square(states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        return states.square().sum(-1) + actions.sum(-1)

    plain = improving(load_experiment("double_pendulum"), FunctionCost(square))
    task = with_history(plain, past_actions=1)
    states, actions = draws.normal(3, 5, 6), draws.normal(3, 5, 2)
    assert torch.equal(task.cost.function(states, actions), square(states[..., :4], actions))
    assert task.cost.said == plain.cost.said


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("kind", KINDS)
def test_run_learns_with_a_history(tmp_path: Path, kind: str) -> None:
    """The whole way, with its figures, diagnosis and files."""
    experiment: Task = with_history(short_experiment(), **KINDS[kind])
    result = train(replace(experiment, name=kind), 0, 2, tmp_path, "", progress_bar=False)
    assert result.summary["settings"]["history"]["past_actions"] == KINDS[kind]["past_actions"]
    assert (tmp_path / "policy.pt").exists() and (tmp_path / "summary.json").exists()
