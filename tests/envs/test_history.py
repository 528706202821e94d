"""A state that holds the past, as the known part of the dynamics has it."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.utils import check_env_specs

from tests.helpers.draws import Draws
from torch_pmil.control.known_part import KnownPart
from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.history import History, HistoryEnv
from torch_pmil.envs.rollouts import states_of

NAMES, ACTIONS, PERIOD = ("q1", "dq1", "q2", "dq2"), ("tau1", "tau2"), 0.1
POSITIONS = History(NAMES, ACTIONS, PERIOD, hidden=("dq1", "dq2"), past_actions=2)
MUCH = History(NAMES, ACTIONS, PERIOD, past=("dq1", "dq2"), past_entries=2, past_actions=1)


def resting(states: Tensor) -> Tensor:
    return torch.full((*states.shape[:-1], 2), 0.25, dtype=states.dtype)


def make_env(history: History, **settings: object) -> HistoryEnv:
    return HistoryEnv(DoublePendulumEnv, history, resting, **settings)


def rolled_out(history: History, **settings: object) -> TensorDictBase:
    env = make_env(history, seed=3, **settings)
    draw = partial(Draws(0).uniform, -5.0, 5.0, *env.action_spec.shape)
    return env.rollout(6, lambda tensordict: tensordict.set("action", draw()))


each_history = pytest.mark.parametrize("history", [POSITIONS, MUCH], ids=["positions", "much"])


@each_history
@pytest.mark.parametrize("num_envs", [None, 3])
def test_torchrl_accepts_the_environment(history: History, num_envs: int | None) -> None:
    torch.manual_seed(0)
    check_env_specs(make_env(history, num_envs=num_envs))


def test_hidden_velocities_are_told_by_positions_and_past_actions_are_those_taken() -> None:
    rollout = rolled_out(POSITIONS)
    states, actions = states_of(rollout), rollout["action"].clamp(-3.5, 3.5)
    positions = states[:, [0, 2]]
    assert (states[0, [1, 3]] == 0).all() and (states[0, 4:] == 0.25).all()
    torch.testing.assert_close(states[1:, [1, 3]], positions.diff(dim=0) / PERIOD)
    torch.testing.assert_close(states[1:, 4:6], actions)
    torch.testing.assert_close(states[2:, 6:], actions[:-1])


def test_past_entries_are_those_of_the_periods_before() -> None:
    states = states_of(rolled_out(MUCH, num_envs=3))
    velocities = states[..., [1, 3]]
    torch.testing.assert_close(states[:, 0, 4:8], velocities[:, 0].repeat(1, 2))
    torch.testing.assert_close(states[:, 1:, 4:6], velocities[:, :-1])
    torch.testing.assert_close(states[:, 2:, 6:8], velocities[:, :-2])


def test_robot_moves_as_without_a_history() -> None:
    with_history = rolled_out(MUCH)
    env = DoublePendulumEnv(seed=3)
    env.reset()
    for step in with_history:
        shown = env.step(TensorDict({"action": step["action"]}))["next", "observation"]
        assert torch.equal(shown, step["next", "observation"][:4])


@each_history
def test_known_part_says_what_the_environment_does(history: History) -> None:
    rollout = rolled_out(history)
    known = KnownPart.of_readings(history.shift, history.gain, history.measured)
    x, after = rollout["observation"], rollout["next", "observation"]
    taken = rollout["action"].clamp(-3.5, 3.5)
    outputs = known.targets(x, taken, after)
    assert known.num_outputs == len(history.measured)
    torch.testing.assert_close(known.successors(x, taken, outputs), after)


def test_start_may_be_given_with_its_past() -> None:
    env, start = make_env(POSITIONS), torch.arange(8, dtype=torch.float64) / 8
    assert torch.equal(env.reset(TensorDict({"observation": start}))["observation"], start)
    after = env.step(TensorDict({"action": torch.zeros(2).double()}))["next", "observation"]
    torch.testing.assert_close(after[1], (after[0] - start[0]) / PERIOD)
    assert (after[4:6] == 0).all() and torch.equal(after[6:], start[4:6])


def test_guard_sees_the_whole_state_and_the_robot_is_asked_about_its_own() -> None:
    env = make_env(POSITIONS)
    env.guard = lambda states: "torque" if states[..., 4] == 1 else ""
    env.reset()
    result = env.step(TensorDict({"action": torch.ones(2).double()}))["next"]
    assert result["done"] and env.cut_short == "torque"
    states = torch.zeros(5, 8, dtype=torch.float64)
    assert env.needed_torques(states).shape == (4, 2)
    assert env.beyond_range(states).shape == (5, 2) and env.torque_limits.tolist() == [3.5, 3.5]
    assert env.action_names == ACTIONS and env.action_units == ("N·m", "N·m")
    env.reset()
    assert env.cut_short == ""


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"hidden": ("dq3",)}, "hidden and past must be entries of q1, dq1, q2, dq2, and hidden"),
        ({"hidden": ("q1",)}, "velocities dNAME beside NAME, got q1"),
        ({"past": ("speed",)}, "got speed"),
        ({"past_actions": -1}, "past_actions must be a whole number from 0 on, got -1"),
        ({"past_entries": 0.5}, "past_entries must be a whole number from 0 on, got 0.5"),
    ],
)
def test_histories_that_make_no_sense_are_refused(wrong: dict, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        History(NAMES, ACTIONS, PERIOD, **wrong)


def test_actions_with_names_of_entries_are_told_apart() -> None:
    """As joint targets are, which have the names of their joints."""
    history = History(("q", "dq"), ("q",), 0.5, past=("q", "dq"), past_entries=1, past_actions=1)
    assert history.state_names == ("q", "dq", "q@1", "dq@1", "action q@1")
    state = history.begin(torch.tensor([1.0, 2.0]), torch.tensor([3.0]))
    after = history.advanced(state, torch.tensor([4.0]), torch.tensor([5.0, 6.0]))
    assert state.tolist() == [1, 2, 1, 2, 3] and after.tolist() == [5, 6, 1, 2, 4]


def test_names_may_hold_what_marks_the_past() -> None:
    history = History(("q@left", "w"), ("tau@1",), 0.5, (), ("q@left",), 2, past_actions=2)
    state = history.begin(torch.tensor([1.0, 9.0]), torch.tensor([3.0]))
    for number in (4.0, 5.0):
        state = history.advanced(state, torch.tensor([number]), torch.tensor([number / 2, 9.0]))
    assert state.tolist() == [2.5, 9.0, 2.0, 1.0, 5.0, 4.0]
