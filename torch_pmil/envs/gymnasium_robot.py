"""A robot of this package as gymnasium's users know an environment. Needs the extra ``gym``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from tensordict import TensorDict

from torch_pmil.envs.registration import ROBOTS
from torch_pmil.envs.robot import Array


class GymnasiumRobot(gymnasium.Env):
    """A simulated robot, with the physics and, for one seed, the starts of its TorchRL environment.

    Observations and actions are those of that environment, float64 in its units. The reward is
    zero, as imitation has none, and an episode ends by its time limit alone.

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

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, name: str, render_mode: str | None = None, **settings: Any) -> None:
        self.render_mode = render_mode
        self._robot = ROBOTS[name][0](**settings)
        limits = self._robot.action_spec.space
        self.observation_space = Box(
            -np.inf, np.inf, self._robot.observation_spec["observation"].shape, np.float64
        )
        self.action_space = Box(limits.low.numpy(), limits.high.numpy(), dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Array, dict]:
        """Start anew; a seed determines this start and those that follow."""
        super().reset(seed=seed)
        if seed is not None:
            self._robot.set_seed(seed)
        self._state = self._robot.reset()["observation"]
        return self._state.numpy().copy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict]:
        """Hold the actions for a control period. Raises ValueError where they are not finite."""
        held = torch.as_tensor(np.asarray(action), dtype=torch.float64)
        self._state = self._robot.step(TensorDict({"action": held}))["next", "observation"]
        return self._state.numpy().copy(), 0.0, False, False, {}

    def render(self) -> np.ndarray | None:
        """A picture (height, width, 3), uint8, with render_mode "rgb_array".

        Raises RuntimeError without OpenGL.
        """
        return None if self.render_mode is None else self._robot.render(self._state)

    def close(self) -> None:
        """Release what the pictures needed."""
        self._robot.close()
