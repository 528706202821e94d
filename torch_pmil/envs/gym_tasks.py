"""Two tasks of gymnasium as robots. Needs the extra ``gym``."""

from __future__ import annotations

import math
import os
from functools import partial
from typing import Any

import numpy as np
from torchrl.envs import EnvBase, GymEnv, GymWrapper

from torch_pmil.envs.adapter import AdaptedEnv, CosSin
from torch_pmil.envs.robot import Array

try:
    import gymnasium
    from gymnasium import Env, Wrapper
except ModuleNotFoundError:  # an optional extra
    gymnasium, Env, Wrapper = None, object, object

CART_START = 0.1  # largest absolute value of each entry of the cart's first state
HANGING_MEAN, HANGING_STD = (math.pi, 0.0), (0.05, 0.1)  # rad, rad/s
PENDULUM_REPEAT = 2  # steps of 0.05 s that a torque is held for


def inverted_pendulum_env(
    num_envs: int | None = None, from_pixels: bool = False, seed: int | None = None
) -> AdaptedEnv:
    """gymnasium's InvertedPendulum-v5: a pole on a cart, at 25 Hz.

    The state is [x, q, dx, dq] (m, rad, m/s, rad/s), q the angle of the pole from upright; each
    entry starts uniformly within ±0.1. The action moves the cart, within ±3.

    Raises:
        ModuleNotFoundError: gymnasium is not installed.
    """
    return AdaptedEnv(
        _make_cart, control_period=0.04, num_envs=num_envs, from_pixels=from_pixels, seed=seed
    )


def gym_pendulum_env(
    num_envs: int | None = None, from_pixels: bool = False, seed: int | None = None
) -> AdaptedEnv:
    """gymnasium's Pendulum-v1 at 10 Hz, with normal starts about hanging (0.05 rad, 0.1 rad/s).

    The state is [q, dq] (rad, rad/s), q the angle from upright, computed from gymnasium's cosine
    and sine. The action is the torque, within ±2 N·m: too little to lift the pendulum directly.

    Raises:
        ModuleNotFoundError: gymnasium is not installed.
    """
    angle = CosSin(cos=0, sin=1, near=HANGING_MEAN[0])
    return AdaptedEnv(
        _make_pendulum,
        control_period=0.1,
        num_envs=num_envs,
        angles=(angle,),
        from_pixels=from_pixels,
        seed=seed,
    )


def cart_dynamics() -> partial[Array]:
    """A period of InvertedPendulum-v5: states (N, 4) and actions (N, 1) to states (N, 4)."""
    check_gymnasium()
    return partial(_simulate_cart, gymnasium.make("InvertedPendulum-v5").unwrapped)


def pendulum_dynamics() -> partial[Array]:
    """A period of Pendulum-v1 at 10 Hz: states (N, 2) and torques (N, 1) to states (N, 2)."""
    check_gymnasium()
    return partial(_simulate_pendulum, gymnasium.make("Pendulum-v1").unwrapped)


class HangingStart(Wrapper):
    """Pendulum-v1 with normal starts about hanging; its own are uniform about upright."""

    def reset(self, **kwargs: Any) -> tuple[np.ndarray, dict]:
        """Start hanging."""
        _, info = self.env.reset(**kwargs)
        robot = self.env.unwrapped
        noise = robot.np_random.normal(size=2)
        robot.state = np.array(HANGING_MEAN) + np.array(HANGING_STD) * noise
        return robot._get_obs(), info


def check_gymnasium() -> None:
    if gymnasium is None:
        raise ModuleNotFoundError(
            "this task needs gymnasium, which is not installed: pip install 'torch_pmil[gym]'"
        )


def _make_cart(from_pixels: bool = False) -> EnvBase:
    check_gymnasium()
    return GymEnv(
        "InvertedPendulum-v5",
        from_pixels=from_pixels,
        pixels_only=False,
        reset_noise_scale=CART_START,
    )


def _make_pendulum(from_pixels: bool = False) -> EnvBase:
    check_gymnasium()
    if from_pixels:
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pygame draws without a window
    robot = gymnasium.make(
        "Pendulum-v1", render_mode="rgb_array" if from_pixels else None, disable_env_checker=True
    )
    return GymWrapper(
        HangingStart(robot), frame_skip=PENDULUM_REPEAT, from_pixels=from_pixels, pixels_only=False
    )


def _simulate_cart(robot: gymnasium.Env, states: Array, actions: Array) -> Array:
    following = []
    for state, action in zip(states, actions, strict=True):
        robot.set_state(*np.split(state, 2))
        following.append(robot.step(action)[0])
    return np.array(following)


def _simulate_pendulum(robot: gymnasium.Env, states: Array, torques: Array) -> Array:
    following = []
    for state, torque in zip(states, torques, strict=True):
        robot.state = state
        for _ in range(PENDULUM_REPEAT):
            robot.step(torque)
        following.append(robot.state)
    return np.array(following)
