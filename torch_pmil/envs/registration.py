"""The simulated robots as environments of gymnasium; another one is a line in ``ROBOTS``."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from torch_pmil.envs.biorob import BioRobEnv
from torch_pmil.envs.cart_pole import CartPoleEnv
from torch_pmil.envs.double_pendulum import DoublePendulumEnv
from torch_pmil.envs.double_pendulum_servo import DoublePendulumServoEnv
from torch_pmil.envs.gym_tasks import Env, gymnasium
from torch_pmil.envs.pendubot import AcrobotEnv, PendubotEnv
from torch_pmil.envs.robot import Array

# the environment, and the steps of an episode
ROBOTS = {
    "DoublePendulum-v0": (DoublePendulumEnv, 25),
    "DoublePendulumServo-v0": (DoublePendulumServoEnv, 25),
    "BioRob-v0": (BioRobEnv, 18),
    "Pendubot-v0": (PendubotEnv, 250),
    "Acrobot-v0": (AcrobotEnv, 250),
    "CartPole-v0": (CartPoleEnv, 40),
}


class GymnasiumRobot(Env):
    """A simulated robot as an environment of gymnasium. Needs the extra ``gym``.

    Physics, observations, actions, units and the starts of a seed are those of the TorchRL
    environment. The reward is zero, and an episode ends by its time limit alone.

    Args:
        name: in ``ROBOTS``.
        render_mode: None or "rgb_array".
        settings: of the TorchRL environment.

    Raises:
        ValueError: a setting is wrong.

    Example:
        >>> import torch_pmil.envs
        >>> env = gymnasium.make("torch_pmil/DoublePendulum-v0", torque_limit=2.0)
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape, env.action_space.high
        ((4,), array([2., 2.]))
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(self, name: str, render_mode: str | None = None, **settings: Any) -> None:
        self.render_mode = render_mode
        self._robot = ROBOTS[name][0](**settings)
        self.metadata = {**self.metadata, "render_fps": round(1 / self._robot.control_period)}
        box, limits = gymnasium.spaces.Box, self._robot.action_spec.space
        shape = self._robot.observation_spec["observation"].shape
        self.observation_space = box(-np.inf, np.inf, shape, np.float64)
        self.action_space = box(limits.low.numpy(), limits.high.numpy(), dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Array, dict]:
        """Start again; a seed determines this start and the following ones."""
        super().reset(seed=seed)
        if seed is not None:
            self._robot.set_seed(seed)
        self._state = self._robot.reset()["observation"]
        return self._state.numpy().copy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict]:
        """Hold the actions for a control period. Raises ValueError if they are not finite."""
        held = torch.as_tensor(np.asarray(action), dtype=torch.float64)
        self._state = self._robot.step(TensorDict({"action": held}))["next", "observation"]
        return self._state.numpy().copy(), 0.0, False, False, {}

    def render(self) -> np.ndarray | None:
        """A picture (height, width, 3), uint8. Raises RuntimeError without OpenGL."""
        return None if self.render_mode is None else self._robot.render(self._state)

    def close(self) -> None:
        """Release the resources of the pictures."""
        self._robot.close()


def register_robots() -> None:
    """Register each robot with gymnasium, if that is installed, as ``torch_pmil/NAME``, once."""
    if gymnasium is None:
        return
    for name, (_, steps) in ROBOTS.items():
        if f"torch_pmil/{name}" not in gymnasium.registry:
            gymnasium.register(
                f"torch_pmil/{name}",
                entry_point="torch_pmil.envs.registration:GymnasiumRobot",
                kwargs={"name": name},
                max_episode_steps=steps,
            )
