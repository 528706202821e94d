"""Our robots as environments of gymnasium."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from tests.envs.driving import drawn, step
from torch_pmil.envs import DoublePendulumEnv, registration
from torch_pmil.envs.registration import ROBOTS, register_robots

each_robot = pytest.mark.parametrize("name", ROBOTS)


@each_robot
def test_gymnasium_accepts_the_robot(name: str) -> None:
    with warnings.catch_warnings():
        # SI units, any state
        expected = ".*(symmetric and normalized space|Box observation space m|no-render).*"
        warnings.filterwarnings("ignore", expected)
        check_env(gymnasium.make(f"torch_pmil/{name}").unwrapped, skip_render_check=True)


@pytest.mark.slow
@each_robot
def test_robot_is_known_to_gymnasium_when_the_environments_are_imported(name: str) -> None:
    code = f"import torch_pmil.envs, gymnasium; print(gymnasium.make('torch_pmil/{name}').spec.id)"
    result = drawn(code)
    assert result.stdout.strip() == f"torch_pmil/{name}"


@each_robot
def test_physics_and_starts_are_those_of_the_torchrl_environment_to_the_bit(name: str) -> None:
    robot, steps = ROBOTS[name]
    ours, theirs = robot(seed=4), gymnasium.make(f"torch_pmil/{name}")
    limits = ours.action_spec.space.high
    shares = np.random.default_rng(0).uniform(-1.1, 1.1, (2, steps, len(limits)))  # some beyond
    for episode, torques in enumerate(limits * torch.from_numpy(shares)):
        expected = [ours.reset(), *(step(ours, torque) for torque in torques)]
        seen, info = theirs.reset(seed=4 if episode == 0 else None)
        assert np.array_equal(seen, expected[0]["observation"].numpy()) and info == {}
        for count, torque in enumerate(torques.numpy(), start=1):
            seen, *others = theirs.step(torque)
            assert np.array_equal(seen, expected[count]["observation"].numpy())
            assert seen.dtype == np.float64 and others == [0.0, False, count == steps, {}]


PENDULUM = "torch_pmil/DoublePendulum-v0"


def test_settings_reach_the_robot_and_bad_ones_are_refused() -> None:
    env = gymnasium.make(PENDULUM, torque_limit=(1.0, 2.0), initial_std=[0.0] * 4)
    assert env.action_space.high.tolist() == [1.0, 2.0]
    assert np.array_equal(env.reset()[0], DoublePendulumEnv().initial_mean.numpy())
    with pytest.raises(ValueError, match="torque_limit must be one or 2 positive finite numbers"):
        gymnasium.make(PENDULUM, torque_limit=-1.0)
    rates = [
        gymnasium.make(name).metadata["render_fps"] for name in (PENDULUM, "torch_pmil/Pendubot-v0")
    ]
    assert rates == [10, 25]


def test_observations_are_the_users_to_change_and_closing_twice_is_no_error() -> None:
    env = gymnasium.make(PENDULUM)
    env.reset(seed=0)[0][:] = 99.0
    assert np.abs(env.step(np.zeros(2))[0]).max() < 10
    env.close()
    env.close()


@pytest.mark.slow
def test_pictures_are_those_of_the_robot() -> None:
    env = gymnasium.make(PENDULUM, render_mode="rgb_array")
    state, _ = env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 480, 3) and picture.dtype == np.uint8
    assert np.array_equal(picture, DoublePendulumEnv().render(torch.from_numpy(state)))


def test_registering_again_or_without_gymnasium_does_nothing(monkeypatch) -> None:
    before = dict(gymnasium.registry)
    register_robots()
    monkeypatch.setattr(registration, "gymnasium", None)
    register_robots()
    assert gymnasium.registry == before
