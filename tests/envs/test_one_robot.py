"""One environment as a robot: what an experiment asks for is made of it."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule

from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.adapter import CosSin
from torch_pmil.envs.one_robot import OneRobot

gymnasium = pytest.importorskip("gymnasium")


def feedback(state: torch.Tensor) -> torch.Tensor:
    return state[..., :1].sin()


POLICY = TensorDictModule(feedback, in_keys=["observation"], out_keys=["action"])


def same(rollout: TensorDictBase, other: TensorDictBase) -> bool:
    return torch.equal(rollout["next", "observation"], other["next", "observation"])


def test_rollouts_in_turn_are_those_of_the_robot_one_by_one() -> None:
    robot = OneRobot("InvertedPendulum-v5", control_period=0.04)
    together = robot(num_envs=3, seed=7).rollout(5, POLICY)
    alone = robot(seed=7)
    for rollout in together:
        assert same(rollout, alone.rollout(5, POLICY))
    assert together.batch_size == (3, 5)
    starts = together["observation"][:, 0]
    assert not torch.equal(starts[0], starts[1])


def test_an_action_is_held_for_the_steps_of_a_control_period() -> None:
    slow = OneRobot(gymnasium.make("InvertedPendulum-v5"), control_period=0.08)(seed=0)
    fast = OneRobot(gymnasium.make("InvertedPendulum-v5"), control_period=0.04)(seed=0)
    push = TensorDictModule(
        lambda state: torch.ones(1).double(), in_keys=["observation"], out_keys=["action"]
    )
    assert same(slow.rollout(3, push), fast.rollout(6, push)[1::2])


def test_other_environments_and_periods_are_refused() -> None:
    with pytest.raises(ValueError, match=r"whole number of the environment's steps of 0.04 s, got"):
        OneRobot("InvertedPendulum-v5", control_period=0.1)
    with pytest.raises(ValueError, match=r"got 0\.01 s"):
        OneRobot("InvertedPendulum-v5", control_period=0.01)
    with pytest.raises(TypeError, match=r"env must be an environment .*, got int"):
        OneRobot(3, control_period=0.1)


def test_angles_of_cosine_and_sine() -> None:
    angle = CosSin(cos=0, sin=1)
    env = OneRobot("Pendulum-v1", control_period=0.05, angles=(angle,))(seed=0)
    state = env.reset()["observation"]
    assert state.shape == (2,) and abs(state[0]) <= math.pi


def test_pictures_are_those_of_the_environment() -> None:
    robot = OneRobot("InvertedPendulum-v5", control_period=0.04)
    assert robot.draws and robot.name == "InvertedPendulum-v5"
    assert not OneRobot(gymnasium.make("InvertedPendulum-v5"), control_period=0.04).draws
    assert not OneRobot(DoublePendulumEnv(), control_period=0.1).draws
