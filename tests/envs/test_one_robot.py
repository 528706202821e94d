"""One environment as a robot: what an experiment asks for is made of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule

from torch_pmil.envs import DoublePendulumEnv
from torch_pmil.envs.adapter import CosSin
from torch_pmil.envs.one_robot import OneRobot
from torch_pmil.envs.turning import Turning

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


class Dial(gymnasium.Env):
    """Turns by its action. It shows its angle in (-pi, pi], and a picture, always in one array."""

    observation_space = gymnasium.spaces.Box(-math.pi, math.pi, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
    render_mode, dt = "rgb_array", 0.1

    def __init__(self) -> None:
        self.shown, self.picture = np.zeros(1), np.zeros((2, 2, 3), np.uint8)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        self.shown[:], self.picture[:] = 0, 0
        return self.shown, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        self.shown[:] = (self.shown + action + math.pi) % (2 * math.pi) - math.pi
        self.picture += 1
        return self.shown, 0.0, False, False, {}

    def render(self) -> np.ndarray:
        return self.picture


def test_robot_that_shows_itself_in_one_array_is_recorded_as_it_moved() -> None:
    robot = OneRobot(Dial(), control_period=0.1)
    robot.turning_entries = (Turning(0, rate=None, near=0.0),)
    shown = robot(from_pixels=True, seed=0).rollout(8, lambda td: td.set("action", torch.ones(1)))
    moved = torch.arange(1, 9)
    torch.testing.assert_close(shown["next", "observation"][:, 0], moved.double())
    assert torch.equal(shown["next", "pixels"][:, 0, 0, 0], moved.byte())


class OldReset(Dial):
    def reset(self, **given: Any) -> np.ndarray:  # type: ignore[override]
        return super().reset(**given)[0]


class Unseeded(Dial):
    def reset(self) -> np.ndarray:  # type: ignore[override]
        return super().reset()[0]


class OldStep(Dial):
    def step(self, action: np.ndarray) -> tuple:  # type: ignore[override]
        shown, reward, end, _, info = super().step(action)
        return shown, reward, end, info


@pytest.mark.parametrize(
    ("env", "got"),
    [
        (OldReset, "ndarray from reset"),
        (Unseeded, r"reset\(\) .*"),
        (OldStep, "4 values from step"),
    ],
)
def test_environment_of_the_old_gym_is_named(env: type[Dial], got: str) -> None:
    with pytest.raises(ValueError, match=rf"^env must have gymnasium's API: .*; got {got}: change"):
        OneRobot(env(), control_period=0.1)(seed=0).rollout(2)


class Hidden(Dial):
    """Says that it gives pictures, and gives none."""

    def render(self) -> None:
        return None


def test_robot_that_renders_nothing_is_refused() -> None:
    with pytest.raises(RuntimeError, match=r"must return a picture \(height, width, 3\), got None"):
        OneRobot(Hidden(), control_period=0.1)(from_pixels=True)
