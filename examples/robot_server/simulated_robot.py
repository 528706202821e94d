"""The robot behind the server: a MuJoCo model that moves in real time."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import torch

from torch_pmil.envs import MujocoRobotEnv
from torch_pmil.envs.actuators import actuator_kinds
from torch_pmil.envs.mujoco_model import FULL_PHYSICS


class SimulatedRobot:
    """A simulated robot that is held at its start until the first action.

    Stopped, its motors give no torque and its servos hold where they are.

    Args:
        env: gives the model and the starts.
    """

    def __init__(self, env: MujocoRobotEnv) -> None:
        self.env, self._data = env, mujoco.MjData(env.model)
        self._physics = np.empty(mujoco.mj_stateSize(env.model, FULL_PHYSICS))
        self._holds = np.array(actuator_kinds(env.model)) == "position"
        self.put_back()

    def put_back(self) -> None:
        """Go to a new start."""
        shown = self.env.reset()
        start = shown.get("state", shown["observation"])
        no_actions = torch.zeros(0, self.env.model.nu, dtype=torch.float64)
        physics = self.env.replay(start, no_actions, 1)[0].numpy()
        mujoco.mj_setState(self.env.model, self._data, physics, FULL_PHYSICS)
        self.stop()

    def act(self, action: Sequence[float]) -> None:
        """Take an action within the range of the motors, and hold it."""
        limits = self.env.action_spec.space
        self._data.ctrl = np.clip(action, limits.low.numpy(), limits.high.numpy())

    def stop(self) -> None:
        """Come to rest."""
        mujoco.mj_forward(self.env.model, self._data)  # the lengths are those before the last step
        self._data.ctrl = np.where(self._holds, self._data.actuator_length, 0.0)

    def advance(self) -> None:
        """Move for one time step."""
        mujoco.mj_step(self.env.model, self._data)

    def state(self) -> np.ndarray:
        """State vector (D,) now."""
        mujoco.mj_getState(self.env.model, self._data, self._physics, FULL_PHYSICS)
        return self.env.state_of(torch.from_numpy(self._physics)).numpy()
